"""Match two shapes: a point map, its quality, and pictures."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from spectra_kit._types import Ints
from spectra_kit._validate import check_count, check_indices
from spectra_kit.cli import program, tables
from spectra_kit.cli.folder import check_folder, drawing, together
from spectra_kit.cli.inputs import assemble, load
from spectra_kit.cli.options import DEMO
from spectra_kit.cli.output import as_json, print_blocks, print_json
from spectra_kit.cli.outputs import up_of
from spectra_kit.cli.progress import step
from spectra_kit.cli.quality import Errors, Side, doubts_of, errors_of, quality_of
from spectra_kit.cli.solving import check_solvers, solve
from spectra_kit.cli.words import stem
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import Geometry, creature_pair, write
from spectra_kit.geometry.formats._arrays import text_lines, whole
from spectra_kit.geometry.formats.numpy_arrays import read_npy
from spectra_kit.matching import Match, match, prepare
from spectra_kit.matching.prepare import LOWEST_K

_MAPS = ("point_map.npy", "functional_map.npy", "report.json")
_SIDES = ("source.npz", "target.npz")
_MIRRORED = {"either": None, "kept": False, "reversed": True}
_PICTURES = ("correspondence.png", "functional_map.png", "errors.png")


def match_shapes(asked: program.Match) -> None:
    """Match, judge the map, write maps, report and pictures into one folder."""
    folder, known = asked.output.output, asked.known
    if asked.reading.changed and (known.landmarks or known.truth):
        raise InvalidInputError(
            "--landmarks and --truth number the points of the files, which --repair and --cloud"
            " change; repair or sample first, and match what came out"
        )
    check_count("-k", asked.solver.k, low=LOWEST_K)
    check_solvers(asked.solver, asked.reading.seed, asked.solver.solver)
    check_folder(folder, _files(asked), _MAPS + _SIDES + _PICTURES, _inputs(asked))
    geometries, truth = _geometries(asked)
    if known.truth:
        truth = _read_truth(known.truth, *(g.n for g in geometries))
    landmarks = None
    if known.landmarks:
        landmarks = _read_landmarks(known.landmarks, *(g.n for g in geometries))
    source, target = (
        _solve(asked, name, geometry)
        for name, geometry in zip((asked.source, asked.target), geometries, strict=True)
    )
    with step("matching"):
        found, quality = _matched(source, target, landmarks, _MIRRORED[known.sides])
    with step("judging the map"):
        quality |= quality_of(source, target, found.point_map)
        errors = None if truth is None else errors_of(source, found.point_map, truth)
    if errors is not None:
        quality |= errors.summary()
    record = {
        "source": _side_record(source),
        "target": _side_record(target),
        "landmarks": 0 if landmarks is None else len(landmarks[0]),
        "match": quality,
    }
    sides = (source, target) if _writes_sides(asked) else ()
    with step(f"writing {folder}"):
        written = _write(folder, found, record, sides)
    if not asked.drawing.no_pictures:
        with drawing(_pictures(folder, errors), kept=f"the numbers in {folder} are whole"):
            written += _draw(asked, source, target, found, errors)
    if asked.general.json:
        print_json(**record, written=[str(path) for path in written])
        return
    print_blocks(
        *(tables.headline(side.name, side.geometry, side.laplacian) for side in (source, target)),
        f"the map: the point of {source.name} that each point of {target.name} is",
        tables.pairs({name.replace("_", " "): _told(value) for name, value in quality.items()}),
        "\n".join(f"written: {path}" for path in written),
    )


def _writes_sides(asked: program.Match) -> bool:
    """Whether the maps number other points than those of files that exist."""
    return asked.reading.changed or DEMO in (asked.source, asked.target)


def _is_demo_pair(asked: program.Match) -> bool:
    return asked.source == asked.target == DEMO and asked.reading.cloud is None


def _files(asked: program.Match) -> tuple[str, ...]:
    """Names of all that will be written."""
    truth = asked.known.truth or _is_demo_pair(asked)
    pictures = () if asked.drawing.no_pictures else _PICTURES if truth else _PICTURES[:2]
    return _MAPS + (_SIDES if _writes_sides(asked) else ()) + pictures


def _inputs(asked: program.Match) -> set[Path]:
    """Files that are read."""
    names = (asked.source, asked.target, asked.known.landmarks, asked.known.truth)
    return {Path(name) for name in names if name not in (DEMO, None)}


def _geometries(asked: program.Match) -> tuple[tuple[Geometry, Geometry], Ints | None]:
    """Read or make both; the demo is one animal in two poses, whose true map is known."""
    names = (asked.source, asked.target)
    if _is_demo_pair(asked):
        n = asked.reading.points
        source, target, truth = creature_pair(n, max(9 * n // 10, 500), seed=asked.reading.seed)
        return (source, target), truth
    read = [load(name, asked.reading, pose=pose) for pose, name in enumerate(names, start=1)]
    return (read[0], read[1]), None


def _solve(asked: program.Match, name: str, geometry: Geometry) -> Side:
    with step(f"{name}: assembling the Laplacian of {geometry.n:,} points"):
        laplacian = assemble(asked.operator, geometry)
    solver = asked.solver
    spectrum = solve(laplacian, solver.k, solver.solver, solver, asked.reading.seed)
    return Side(name, geometry, laplacian, spectrum)


def _matched(
    source: Side, target: Side, landmarks: tuple[Ints, Ints] | None, mirrored: bool | None
) -> tuple[Match, tables.Record]:
    """The maps, and what the match says of itself."""
    start = time.perf_counter()
    prepared = [prepare(side.spectrum, side.geometry) for side in (source, target)]
    middle = time.perf_counter()
    found = match(
        prepared[0], prepared[1], landmarks=landmarks, mirrored=mirrored, k=source.spectrum.k
    )
    return found, {
        "prepare_seconds": middle - start,
        "match_seconds": time.perf_counter() - middle,
        "convincing": found.convincing,
        "ambiguous": found.ambiguous,
        **({"doubts": doubts_of(found)} if found.doubts else {}),
        "margin": found.margin,
        "other_side": found.mirror_margin,
        "score": found.score,
        "candidates": len(found.candidates),
        "mirrored": found.mirrored,
        "orientation": found.orientation,
        "coverage_over_chance": found.coverage,
    }


def _read_landmarks(path: Path, n_source: int, n_target: int) -> tuple[Ints, Ints]:
    """Two columns of numbers: on the source, on the target."""
    rows = []
    for number, words in text_lines(path):
        try:
            source, target = map(whole, words)
        except ValueError as error:
            raise InvalidInputError(
                f"{path}: must hold lines of two integers, on the source and on the target, got"
                f" {' '.join(words)[:60]!r} in line {number}"
            ) from error
        rows.append((source, target))
    if not rows:
        raise InvalidInputError(f"{path}: must hold lines of two integers, got none")
    try:
        return (
            check_indices("source landmarks", [source for source, _ in rows], n_source),
            check_indices("target landmarks", [target for _, target in rows], n_target),
        )
    except InvalidInputError as error:
        raise InvalidInputError(f"{path}: {error}; are the columns exchanged?") from error


def _read_truth(path: Path, n_source: int, n_target: int) -> Ints:
    """An integer for each target point, below n_source; negative where it is not known."""
    try:
        truth = np.asarray(read_npy(path)[0])
    except InvalidInputError as error:
        raise InvalidInputError(f"{path}: {error}") from error
    fits = truth.dtype.kind in "iu" and truth.shape == (n_target,)
    if not fits or truth.max() < 0 or truth.max() >= n_source:
        raise InvalidInputError(
            f"{path}: must hold {n_target} integers below {n_source}, the source point of each"
            f" target point, some of them known, got {truth.dtype} of shape {truth.shape}; are"
            " source and target exchanged?"
        )
    return np.asarray(truth, dtype=np.int64)


def _side_record(side: Side) -> tables.Record:
    provenance = side.spectrum.provenance
    return {
        "input": side.name,
        **tables.geometry_record(side.geometry),
        **tables.operator_record(side.laplacian),
        "solver": provenance.solver,
        "modes": side.spectrum.k,
        "seconds": sum(provenance.seconds.values()),
    }


def _write(
    folder: Path, found: Match, record: tables.Record, sides: tuple[Side, ...]
) -> list[Path]:
    """The two maps, the report, and the shapes they belong to, all or none."""
    points, functions, report = _MAPS
    with together(folder, report=report, replacing=_PICTURES) as part:
        np.save(part / points, found.point_map)
        np.save(part / functions, found.functional_map)
        (part / report).write_text(as_json(record))
        for name, side in zip(_SIDES, sides, strict=False):
            write(side.geometry, part / name)
    return [folder / name for name in (*_MAPS, *_SIDES[: len(sides)])]


def _pictures(folder: Path, errors: Errors | None) -> list[Path]:
    return [folder / name for name in (_PICTURES[:2] if errors is None else _PICTURES)]


def _draw(
    asked: program.Match,
    source: Side,
    target: Side,
    found: Match,
    errors: Errors | None,
) -> list[Path]:
    from spectra_kit.viz import (
        Page,
        View,
        plot_correspondence,
        plot_error_curves,
        plot_functional_map,
    )

    folder, dpi = asked.output.output, asked.drawing.dpi
    paths = _pictures(folder, errors)
    names = tuple(stem(side.name) for side in (source, target))
    title = " to ".join(names)
    plot_correspondence(
        paths[0],
        source.geometry,
        target.geometry,
        found.point_map,
        errors=None if errors is None else errors.known,
        error_label=errors.label if errors else "",
        view=View(up_of(asked.drawing, source.name), asked.drawing.turn),
        names=(names[0], names[1]) if names[0] != names[1] else ("source", "target"),
        page=Page(title, f"{source.geometry.n:,} and {target.geometry.n:,} points", dpi),
    )
    page = Page(title, dpi=dpi)
    plot_functional_map(paths[1], found.functional_map, page=page)
    if errors is not None:
        plot_error_curves(
            paths[2], {title: errors.known.direct}, error_label=errors.label, page=page
        )
    return paths


def _told(value: object) -> object:
    """A value as the table shows it."""
    if value is None:
        return "not measured"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else value
