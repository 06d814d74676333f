"""Match two shapes: a point map, its quality, and pictures."""

import time
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import spectra_kit as sk
from spectra_kit._core.types import Ints
from spectra_kit._core.validate import check_indices
from spectra_kit.cli import options, solving, tables
from spectra_kit.cli.components import match_parts
from spectra_kit.cli.inputs import Numbering, assemble, load, of_file
from spectra_kit.cli.match_result import MAP, PARTS, PICTURES, doubts_of, setting
from spectra_kit.cli.output import REPORT, check_folder, tell_folder
from spectra_kit.cli.progress import step
from spectra_kit.errors import InvalidInputError

if TYPE_CHECKING:
    from scipy import sparse

    from spectra_kit.geometry import Geometry
    from spectra_kit.maps import MapErrors

_MAPS = (MAP, "functional_map.npy", REPORT)
_COVERED, _PRECISE = "covered.npy", "precise_map.npz"
_OF_ONE_PAIR = (  # the parts are solved for as `match_components` does it
    *("part", "largest", "cloud", "landmarks", "aligned", "initial", "truth", "precise"),
    *("operator", "boundary", "mass", "accuracy", "solver", "rtol", "start", *options.NETWORK),
)
_SIDES = ("source.npz", "target.npz")
_LINES = "hold lines of two integers, on the source and on the target"


@dataclass(frozen=True, kw_only=True)
class _Known(options.Sides, options.Reading, group="input"):
    """The two geometries, and what is known of the map."""

    source: options.GeometryFile = field(kw_only=False)
    target: options.GeometryFile = field(kw_only=False)
    part: bool = False
    """SOURCE is a part, such as a scan that lacks a limb, and TARGET a whole: find which points of
    the whole have a partner on the part, too (covered.npy)"""
    components: bool = False
    """the surfaces have several parts, wherever they stand: find which part of SOURCE each of
    TARGET is, if any, and match these (components.csv; no functional_map.npy)"""
    landmarks: Path | None = None
    """corresponding points: a line for each with its number on the source and on the target,
    counted from 0"""
    aligned: bool = False
    """the shapes lie on each other, as two moments of a recording do: begin with nearest points,
    and search for no other map"""
    initial: Path | None = None
    """begin with this map, and search for no other: the source point of each target point, an .npy
    file"""
    truth: Path | None = None
    """the true source point of each target point, an .npy file to measure errors by (negative:
    unknown)"""


@dataclass(frozen=True, kw_only=True)
class MatchOptions(_Known, options.Operator, options.Solver, options.FolderDrawing):
    """Find the source point that each target point is, and judge the map."""

    examples = (
        "match cat.off lion.off -o maps",
        "match scan.ply body.off --part -o parts",
        "match scene.ply animals.off --components -o parts",
        f"match {options.DEMO} {options.DEMO} --points 2000",
    )
    keys = "source, target, landmarks, match, written"
    operands = "SOURCE TARGET [options]"
    needs = ("maps", "show")

    k: options.Count = 150
    solver: options.SolverName = "automatic"
    output: options.Output = Path("match")
    """folder for the maps, the report and the pictures"""
    precise: bool = False
    """also find where on the triangles of SOURCE each target point lies: its barycentric
    coordinates, a sparse matrix of SciPy (precise_map.npz)"""


def match_shapes(asked: MatchOptions) -> None:
    """Match, judge the map, write maps, report and pictures into one folder."""
    from scipy.sparse import save_npz
    from scipy.spatial import cKDTree

    from spectra_kit.maps.prepare import LOWEST_K

    # The demo is one animal in two poses, whose true map is known.
    is_demo = asked.source == asked.target == options.DEMO and asked.cloud is None
    sampled = asked.cloud is not None
    if sampled and (asked.landmarks or asked.truth or asked.initial):
        raise InvalidInputError(
            "--landmarks, --initial and --truth number the points of the files, which --cloud"
            " changes",
            advice="sample first, and match what came out",
        )
    if asked.part:
        options.refuse_given(
            asked, ["landmarks", "precise", "initial", "aligned"], "with --part; match wholes"
        )
    if asked.components:
        options.refuse_given(asked, _OF_ONE_PAIR, "with --components; match two parts alone")
    if asked.aligned:
        options.refuse_given(asked, ["initial"], "with --aligned; give one of them")
    if asked.k < LOWEST_K:
        raise InvalidInputError(
            "-k", f"be at least {LOWEST_K}", asked.k, advice="solve for more (150 match best)"
        )
    solving.check_solvers(asked, asked.solver)
    # Where the maps number other points than those of files that exist, these are written too.
    sides = _SIDES if sampled or options.DEMO in (asked.source, asked.target) else ()
    drawn = PICTURES if asked.truth or is_demo else PICTURES[:2]
    pictures = () if asked.no_pictures else drawn[:1] if asked.components else drawn
    more = (_COVERED,) * asked.part + (_PRECISE,) * asked.precise
    files = (MAP, PARTS, REPORT, *sides) if asked.components else (*_MAPS, *more, *sides)
    known = (*_MAPS, PARTS, _COVERED, _PRECISE, *_SIDES, *PICTURES)
    check_folder(asked.output, (*files, *pictures), known, asked.inputs)

    truth = landmarks = initial = None
    one: Geometry
    other: Geometry
    if is_demo:
        fewer = max(9 * asked.points // 10, 500)
        one, other, truth = sk.geometry.creature_pair(asked.points, fewer, seed=asked.seed)
        there = Numbering(np.arange(one.n), one.n), Numbering(np.arange(other.n), other.n)
    else:
        one, first = load(asked.source, asked, pose=1)
        other, second = load(asked.target, asked, pose=2)
        there = first, second
    if asked.components:
        match_parts(asked, (one, other), there, files, sides, pictures)
        return
    _check_triangles(asked, one, other)
    if asked.truth:
        truth = _read_map(asked.truth, "--truth", *there)
    if asked.initial:
        initial = _read_map(asked.initial, "--initial", *there)
    elif asked.aligned:
        initial = cKDTree(one.points).query(other.points)[1]
    if asked.landmarks:
        landmarks = _read_landmarks(asked.landmarks, *there)
    source = _solve(asked, asked.source, one)
    target = _solve(asked, asked.target, other)
    with step("matching"):
        found, quality = _matched(asked, source, target, landmarks, initial)
    with step("judging the map"):
        quality |= quality_of(source, target, found)
        errors, label = None, ""
        if truth is not None:
            errors, label = errors_of(source, found.point_map, truth)
            quality |= {
                "error": label,
                "mean_error": float(errors.direct.mean()),
                "median_error": float(np.median(errors.direct)),
                "share_of_errors_below_5": float((errors.direct <= 5).mean()),
                "auc_to_10": sk.maps.auc(errors.direct),
            }
    record = {
        "source": source.record(),
        "target": target.record(),
        "landmarks": 0 if landmarks is None else len(landmarks[0]),
        "match": quality,
    }

    def write(folder: Path) -> None:
        np.save(folder / _MAPS[0], there[1].spread(there[0].first[found.point_map], -1))
        np.save(folder / _MAPS[1], found.functional_map)
        if found.covered is not None:
            np.save(folder / _COVERED, there[1].spread(found.covered, False))
        if found.precise is not None:
            save_npz(folder / _PRECISE, _in_files(found.precise, *there))
        for name, side in zip(sides, (source, target), strict=False):
            sk.write(side.geometry, folder / name)

    tell_folder(
        asked,
        asked.output,
        record,
        *(tables.headline(side.name, side.geometry, side.laplacian) for side in (source, target)),
        f"the map: the point of {source.name} that each{' covered' * asked.part} point of"
        f" {target.name} is",
        tables.pairs({name.replace("_", " "): _told(value) for name, value in quality.items()}),
        files=files,
        pictures=pictures,
        replacing=PICTURES,
        write=write,
        draw=lambda folder: _draw(asked, folder, source, target, found, errors, label),
    )


def _in_files(
    precise: "sparse.csr_array", source: Numbering, target: Numbering
) -> "sparse.csr_array":
    """Return a precise map between the points of the files; rows are empty where there is none."""
    rows = precise[target.number(np.arange(target.n))].tocoo()
    there = target.number(np.arange(target.n))[rows.row] >= 0
    at = rows.row[there], source.first[rows.col[there]]
    return type(precise)((rows.data[there], at), shape=(target.n, source.n))


@dataclass(frozen=True, eq=False)
class Side:
    """One of two shapes, with its operator and its spectrum."""

    name: str
    geometry: "Geometry"
    laplacian: "sk.Laplacian"
    spectrum: "sk.Spectrum"

    def record(self) -> tables.Record:
        """Everything but the modes."""
        provenance = self.spectrum.provenance
        return {
            "input": self.name,
            **tables.geometry_record(self.geometry),
            **tables.operator_record(self.laplacian),
            "solver": provenance.solver,
            "modes": self.spectrum.k,
            "seconds": sum(provenance.seconds.values()),
        }


def _solve(asked: MatchOptions, name: str, geometry: "Geometry") -> Side:
    with step(f"{name}: assembling the Laplacian of {geometry.n:,} points"):
        laplacian = assemble(asked, geometry)
    return Side(name, geometry, laplacian, solving.solve(laplacian, asked.k, asked.solver, asked))


def _check_triangles(asked: MatchOptions, source: "Geometry", target: "Geometry") -> None:
    """Refuse clouds where triangles are asked for."""
    clouds = [not isinstance(side, sk.TriangleMesh) for side in (source, target)]
    if asked.part and any(clouds):
        raise InvalidInputError("--part", "match a mesh to a mesh", "a point cloud")
    if asked.precise and clouds[0]:
        raise InvalidInputError(
            "--precise",
            "have a mesh as SOURCE, whose triangles it tells of",
            "a point cloud",
            advice="leave it out, or exchange the two",
        )


def _matched(
    asked: MatchOptions,
    source: Side,
    target: Side,
    landmarks: tuple[Ints, Ints] | None,
    initial: Ints | None,
) -> tuple["sk.Match", tables.Record]:
    """The maps, and what the match says of itself."""
    start = time.perf_counter()
    first, second = (_prepared(side) for side in (source, target))
    middle = time.perf_counter()
    mirrored, k = asked.mirrored, source.spectrum.k
    if asked.part:
        found = sk.maps.match_part(first, second, mirrored=mirrored, k=k)
    else:
        found = sk.match(
            *(first, second),
            landmarks=landmarks,
            initial=initial,
            mirrored=mirrored,
            k=k,
            precise=asked.precise,
        )
    held = found.landmarks_held
    return found, {
        "prepare_seconds": middle - start,
        "match_seconds": time.perf_counter() - middle,
        "confidence": None if asked.part else found.confidence,  # of parts it is not calibrated
        "convincing": found.convincing,
        "ambiguous": found.ambiguous,
        **({"doubts": doubts_of(found)} if found.doubts else {}),
        "margin": found.margin,
        "other_side": found.mirror_margin,
        "score": found.score,
        "discontinuity": found.discontinuity,
        "candidates": len(found.candidates),
        **({} if not found.alike else {"alike": found.alike}),
        **({} if held is None else {"landmarks_held": int(held.sum())}),
        "mirrored": found.mirrored,
        "orientation": found.orientation,
        "coverage_over_chance": found.coverage,
    }


def _prepared(side: Side) -> "sk.Prepared":
    with of_file(side.name):
        return sk.prepare(side.spectrum, side.geometry)


def _read_landmarks(path: Path, source: Numbering, target: Numbering) -> tuple[Ints, Ints]:
    """Two columns of numbers: on the source, on the target."""
    from spectra_kit.geometry.formats.xyz import read_integers

    with of_file(path):
        try:
            rows = read_integers(path, 2)
        except ValueError as error:
            raise InvalidInputError("--landmarks", _LINES, str(error)) from error
        if not rows:
            raise InvalidInputError("--landmarks", _LINES, "none")
        sources, targets = zip(*rows, strict=True)
        try:
            found = (
                source.number(check_indices("source landmarks", sources, source.n)),
                target.number(check_indices("target landmarks", targets, target.n)),
            )
        except InvalidInputError as error:
            raise InvalidInputError(
                error.argument, error.expected, error.got, advice="are the columns exchanged?"
            ) from error
        lost = np.minimum(*found) < 0
        if lost.any():
            named = f"{rows[int(np.argmax(lost))]}, of which one was left out"
            raise InvalidInputError("--landmarks", "name points that are matched", named)
    return found


def _read_map(path: Path, option: str, source: Numbering, target: Numbering) -> Ints:
    """The source point of each target point; -1 where the truth is not known, or left out."""
    from spectra_kit.geometry.formats.numpy_arrays import read_npy

    truth = option == "--truth"
    with of_file(path):
        read = np.asarray(read_npy(path)[0])
        fits = read.dtype.kind in "iu" and read.shape == (target.n,)
        if not fits or read.max() < 0 or read.max() >= source.n or (read.min() < 0 and not truth):
            raise InvalidInputError(
                option,
                f"hold {target.n} integers below {source.n}, the source point of each target point"
                + (", some of them known" if truth else ""),
                f"{read.dtype} of shape {read.shape}",
                advice="are source and target exchanged?",
            )
        found = source.number(np.asarray(read, dtype=np.int64)[target.first])
        if not truth and (lost := found < 0).any():
            named = f"{lost.sum()} that were left out"
            raise InvalidInputError(option, "lead to points that are kept", named)
    return found


def errors_of(source: Side, point_map: Ints, truth: Ints) -> tuple["MapErrors", str]:
    """Measure a point map (n2,) against the true one, which is negative where it is not known.

    What the errors are is returned too.
    """
    known = np.flatnonzero(truth >= 0)
    if isinstance(source.geometry, sk.TriangleMesh):
        errors = sk.maps.map_errors(source.geometry, point_map, sk.maps.Truth(truth[known], known))
        return errors, "geodesic error, 100 / √area"
    points = source.geometry.points
    straight = np.linalg.norm(points[point_map[known]] - points[truth[known]], axis=1)
    scaled = 100 * straight / np.sqrt(source.laplacian.area)
    return sk.maps.MapErrors(scaled, known), "straight-line error, 100 / √area"


def quality_of(source: Side, target: Side, found: "sk.Match") -> tables.Record:
    """Judge a point map by itself, where it is covered; None stands for what cannot be measured.

    What takes two wholes is not measured of a part.
    """
    from spectra_kit.operators.oriented import oriented_triangles

    shape, point_map, covered = source.geometry, found.point_map, found.covered
    there = np.ones(len(point_map), dtype=bool) if covered is None else covered
    turned = energy = missed = None
    with suppress(InvalidInputError):  # a surface without a consistent winding has no orientation
        a, b = (oriented_triangles(side.geometry) for side in (source, target))
        faces = b.faces[there[b.faces].all(axis=1)]
        turned = sk.maps.orientation(shape.points, a.faces, faces, point_map)
    if covered is None:
        energy = sk.maps.dirichlet_energy(source.laplacian, target.laplacian, point_map)
        if isinstance(
            shape, sk.TriangleMesh
        ):  # from a source point to where the map takes its image
            back = sk.maps.inverse_map(source.spectrum, target.spectrum, point_map)
            missed = float(sk.maps.bijectivity_errors(shape, point_map, back).mean())
    mass = target.spectrum.mass
    return {
        **(
            {}
            if covered is None
            else {
                "covered_points": int(covered.sum()),
                "covered_area": float(mass[covered].sum() / mass.sum()),
            }
        ),
        "point_map_orientation": turned,
        "coverage": sk.maps.coverage(point_map[there], source.spectrum.mass),
        "dirichlet_energy": energy,
        "inverse_error": missed,
    }


def _draw(
    asked: MatchOptions,
    folder: Path,
    source: Side,
    target: Side,
    found: "sk.Match",
    errors: "MapErrors | None",
    label: str,
) -> None:
    there = setting(asked, source.geometry, target.geometry)
    page = replace(there["page"], subtitle="")
    sk.show.plot_correspondence(
        source.geometry,
        target.geometry,
        found.point_map,
        path=folder / PICTURES[0],
        errors=errors,
        error_label=label,
        covered=found.covered,
        **there,
    )
    sk.show.plot_functional_map(found.functional_map, path=folder / PICTURES[1], page=page)
    if errors:
        curves, path = {page.title: errors.direct}, folder / PICTURES[2]
        sk.show.plot_error_curves(curves, path=path, error_label=label, page=page)


def _told(value: object) -> object:
    """A value as the table shows it."""
    if value is None:
        return "not measured"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else value
