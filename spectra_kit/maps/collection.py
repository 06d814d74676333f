"""`match_collection`: maps between many surfaces that agree with each other."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.arrays_file import read_arrays, write_arrays
from spectra_kit._core.checked import checked
from spectra_kit._core.fingerprint import arrays_digest, facts_digest
from spectra_kit._core.records import Brief, Rebuilt
from spectra_kit._core.threads import single_threaded_blas
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count
from spectra_kit._core.version import VERSION
from spectra_kit._core.warn import hearing
from spectra_kit.errors import InvalidInputError
from spectra_kit.features import shape_dna, shape_dna_distances
from spectra_kit.maps.match import LastSteps, matched, matched_from
from spectra_kit.maps.prepare import LOWEST_K, REFINED_K, Prepared, truncated
from spectra_kit.maps.result import DEFAULT, Candidate, Match, MatchOptions
from spectra_kit.maps.score import scored
from spectra_kit.maps.synchronise import (
    LEAD,
    Clusters,
    Found,
    Frames,
    Sampled,
    apart,
    coupled_zoomout,
    groups,
)

_KEPT = ("maps", "scores", "mirrored")  # of what a pair's own match has found, in a file
_LEADS = (LEAD, 12, 24)  # modes from which implied maps are grown anew: the best one counts


@checked
@dataclass(frozen=True, kw_only=True)
class CollectedPair(Brief):
    """A pair that was matched by itself, and what became of it.

    Attributes
    ----------
    source, target : str
        Names of the surfaces.
    score : float
        Of the map that the collection implies; see `score_of`.
    score_alone : float
        Of the map that the pair by itself would have got, by the same mismatches: without the
        alignment that its candidates have in `match`.
    cycle_error : float
        Squared difference per mode of the two maps, in their 20 lowest modes: 0 if they agree, 2 if
        they have nothing in common. Right maps of animals were within 0.12.
    convincing : bool
        Whether the pair by itself seems to correspond; see `Match.convincing`.
    """

    source: str
    target: str
    score: float
    score_alone: float
    cycle_error: float
    convincing: bool


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Collection(Rebuilt):
    """Surfaces with maps to one latent space, through which each is mapped to each.

    Memory is linear in their number: a map between two is worked out when it is asked for.

    Attributes
    ----------
    shapes : dict of str to Prepared
        The surfaces, by name, all with as many modes.
    frames : ndarray of shape (N, k, k)
        Functional map from the latent space to each surface, orthogonal. Their products imply maps
        that agree over all cycles.
    mirrored : ndarray of shape (N,)
        Whether the surface is a mirror image of what the latent space stands for.
    groups : tuple of tuple of str
        Surfaces that convincing pairs connect, the largest group first. Maps between groups are
        doubtful.
    pairs : tuple of CollectedPair
        Those that were matched by themselves.
    options : MatchOptions
        How.
    """

    shapes: Mapping[str, Prepared]
    frames: Floats
    mirrored: NDArray[np.bool_]
    groups: tuple[tuple[str, ...], ...]
    pairs: tuple[CollectedPair, ...]
    options: MatchOptions = DEFAULT

    @property
    def foreign(self) -> tuple[str, ...]:
        """Names of the surfaces that fit no other."""
        return tuple(group[0] for group in self.groups if len(group) == 1)

    @property
    def cycle_errors(self) -> dict[str, float]:
        """Mean cycle error of the pairs of each surface; large where its place is in doubt.

        Of its convincing pairs, or of all where none is.
        """
        errors: dict[str, float] = {}
        for name in self.shapes:
            own = [one for one in self.pairs if name in (one.source, one.target)]
            fitting = [one for one in own if one.convincing] or own
            errors[name] = float(np.mean([one.cycle_error for one in fitting]))
        return errors

    def candidate(self, source: str, target: str) -> Candidate:
        """Return the map that the frames imply, grown anew from the lowest modes, unrefined."""
        i, j = (self._place(end, x) for end, x in (("source", source), ("target", target)))
        a, b = self.shapes[source], self.shapes[target]
        implied, mirrored = self.frames[j] @ self.frames[i].T, self.mirrored[i] != self.mirrored[j]
        with single_threaded_blas():
            return _implied(a, b, implied, bool(mirrored))

    def pair(self, source: str, target: str, *, k: int = 150, elastic: bool = True) -> Match:
        """Return the map between two surfaces, refined as `match` does, with its `k` and `elastic`.

        It has one candidate, and so no rival: both its margins are infinite, and its confidence is
        what it would be if a rival scored as well. It is `Match.unconnected`, and not convincing,
        where one of the two is foreign, or they are of two groups. Warns where it is not
        `Match.convincing`.
        """
        found, ends = [self.candidate(source, target)], (self.shapes[source], self.shapes[target])
        last = LastSteps(check_count("k", k, low=LOWEST_K), elastic)
        connected = any({source, target} <= {*group} for group in self.groups)
        return matched_from(*ends, [found], last, self.options, unconnected=not connected)

    def _place(self, end: str, name: str) -> int:
        if name not in self.shapes:
            raise InvalidInputError(
                end, "be the name of a surface of the collection", repr(name), advice="see `shapes`"
            )
        return list(self.shapes).index(name)

    def __repr__(self) -> str:
        told = f"{len(self.shapes)} surfaces, {len(self.pairs)} pairs matched"
        foreign = f", foreign: {', '.join(self.foreign)}" if self.foreign else ""
        return f"Collection({told}{foreign})"


@checked
def match_collection(
    shapes: Mapping[str, Prepared],
    *,
    neighbours: int = 3,
    mirrored: bool | None = None,
    folder: str | os.PathLike[str] | None = None,
    options: MatchOptions = DEFAULT,
    progress: Callable[[int, int], object] | None = None,
) -> Collection:
    """Match many surfaces with each other, so that their maps agree.

    Parameters
    ----------
    shapes : mapping of str to Prepared
        At least two surfaces, by name; all with a geometry, or none.
    neighbours : int, default 3
        With how many of the most similar ones each is matched by itself, by their eigenvalues
        (`features.shape_dna`). Others are added where they are needed to decide.
    mirrored : bool, optional
        False where no surface is a mirror image of another. Both ways are tried without it, as in
        `match`; True is refused, for two maps that mirror make one that does not.
    folder : path-like, optional
        Where pairs that were matched are kept, and looked for: interrupted, it then goes on. It is
        made if it is not there.
    options : MatchOptions
        As of `match`.
    progress : callable, optional
        Told how many surfaces of how many are joined.

    Returns
    -------
    Collection
        Which maps any of them to any other, and names those that do not belong.

    Raises
    ------
    InvalidFileError
        If a file of the folder is damaged.
    OSError
        If the folder cannot be made, or not be written; what was kept before stays.

    Notes
    -----
    A pair alone may be ambiguous; here the candidates of a few pairs are chosen so that the maps
    they imply between all surfaces, by way of a latent space, score best. See Huang, Wang, Guibas,
    *Functional map networks for analyzing and exploring large shape collections*, SIGGRAPH 2014,
    and Huang, Ren, Wonka, Ovsjanikov, *Consistent ZoomOut*, SGP 2020.

    The number of pairs matched, time and memory are linear in the number of surfaces.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> poses = {f"pose {i}": sk.geometry.creature(500, pose=i) for i in (1, 2, 3)}
    >>> shapes = {name: sk.prepare(sk.spectrum(mesh, 40), mesh) for name, mesh in poses.items()}
    >>> few = sk.maps.MatchOptions(orders=4, growing=16, finalists=2)
    >>> found = sk.maps.match_collection(shapes, mirrored=False, options=few)
    >>> found
    Collection(3 surfaces, 3 pairs matched)
    >>> found.pair("pose 1", "pose 3").point_map.shape
    (500,)
    """
    names, many = list(shapes), _checked(shapes, mirrored)
    check_count("neighbours", neighbours, low=1)
    count = min(shape.spectrum.k for shape in many) - 1
    dnas = [shape_dna(shape.spectrum, min(count, REFINED_K)) for shape in many]
    alone = _Alone(many, mirrored, None if folder is None else Path(folder), options)
    with single_threaded_blas():
        clusters = Clusters(many, shape_dna_distances(dnas), alone, options)
        frames = clusters.joined(neighbours, lambda done: progress and progress(done, len(many)))
        pairs = tuple(_told(names, many, i, j, frames) for i, j in sorted(frames.found))
    label = groups(len(many), frames.found)
    grouped = [tuple(np.array(names)[label == x].tolist()) for x in range(label.max() + 1)]
    return Collection(
        shapes=dict(zip(names, many, strict=True)),
        frames=frames.maps,
        mirrored=frames.mirrored,
        groups=tuple(sorted(grouped, key=len, reverse=True)),
        pairs=pairs,
        options=options,
    )


class _Alone:
    """Matches a pair by itself, unless the folder has it already."""

    def __init__(
        self,
        shapes: list[Prepared],
        mirrored: bool | None,
        folder: Path | None,
        options: MatchOptions,
    ) -> None:
        self._shapes, self._mirrored, self._options = shapes, mirrored, options
        self._folder, self._keys = folder, list[str]()
        if folder is not None:
            if folder.exists() and not folder.is_dir():
                raise InvalidInputError("folder", "be one, or not be there", f"the file {folder}")
            folder.mkdir(parents=True, exist_ok=True)
            self._keys = [_key(shape) for shape in shapes]

    def __call__(self, i: int, j: int) -> Found:
        if self._folder is None:
            return self._matched(i, j)
        facts = {"release": VERSION, "source": self._keys[i], "target": self._keys[j]}
        how = repr((self._mirrored, self._options))
        path = self._folder / f"{facts_digest({**facts, 'how': how})}.npz"
        if path.exists():
            header, arrays = read_arrays(
                *(path, "kept pair of a collection", lambda _: _KEPT),
                remedy="remove it: it is made again",
            )
            return Found(**arrays, convincing=bool(header["convincing"]))
        found = self._matched(i, j)
        arrays = {name: np.asarray(getattr(found, name)) for name in _KEPT}
        write_arrays(path, {"convincing": found.convincing}, arrays)
        return found

    def _matched(self, i: int, j: int) -> Found:
        """Return what `match` chooses from; what it would refine is worked out when asked for."""
        a, b, options = self._shapes[i], self._shapes[j], self._options
        with hearing():  # `convincing` tells of doubts
            one = matched(a, b, LastSteps(REFINED_K, elastic=False), self._mirrored, options)
        return Found(
            maps=np.array([c.functional_map for c in one.candidates]),
            scores=np.array([c.score for c in one.candidates]),
            mirrored=np.array([float(c.mirrored) for c in one.candidates]),
            convincing=one.convincing,
        )


def _checked(shapes: Mapping[str, Prepared], mirrored: bool | None) -> list[Prepared]:
    """Return the surfaces with as many modes each."""
    if mirrored:
        raise InvalidInputError(
            "mirrored",
            "be False or None for a collection",
            mirrored,
            advice="two maps that mirror make one that does not",
        )
    if len(shapes) < 2:
        raise InvalidInputError("shapes", "hold at least two surfaces", len(shapes))
    seen = [name for name, shape in shapes.items() if shape.geometry is not None]
    if seen and len(seen) < len(shapes):
        missing = next(name for name in shapes if name not in seen)
        raise InvalidInputError(
            "shapes",
            "all have their geometry, or none",
            f"none for {missing!r}",
            advice="pass it to prepare",
        )
    fewest = min(shape.spectrum.k for shape in shapes.values())
    return [truncated(shape, fewest) for shape in shapes.values()]


def _key(shape: Prepared) -> str:
    """Return a hash of all that a match takes of a surface."""
    spectrum, seen = shape.spectrum, shape.geometry
    placed = () if seen is None else (seen.points, seen.oriented.faces, shape.curvature)
    parts = (spectrum.eigenvalues, spectrum.eigenvectors, spectrum.mass, shape.samples, *placed)
    return arrays_digest(*parts)


def _implied(a: Prepared, b: Prepared, implied: Floats, mirrored: bool) -> Candidate:
    """Return the candidate that a map becomes when it is grown anew from its lowest modes."""
    source, target = (Sampled.of(shape, len(implied)) for shape in (a, b))
    grown = (coupled_zoomout(source, target, implied[None], lead)[0] for lead in _LEADS)
    return min((scored(a, b, C, mirrored) for C in grown), key=lambda c: c.score)


def _told(
    names: list[str], shapes: list[Prepared], i: int, j: int, frames: Frames
) -> CollectedPair:
    """Return what became of a pair that was matched by itself."""
    a, b, found = shapes[i], shapes[j], frames.found[i, j]
    implied, turns = frames.maps[j] @ frames.maps[i].T, frames.mirrored[i] != frames.mirrored[j]
    chosen = _implied(a, b, implied, bool(turns))
    alone = scored(a, b, found.maps[0], bool(found.mirrored[0]))
    return CollectedPair(
        source=names[i],
        target=names[j],
        score=chosen.score,
        score_alone=alone.score,
        cycle_error=float(apart(found.maps[0], chosen.functional_map)),
        convincing=found.convincing,
    )
