"""Maps of many surfaces to one latent space, so that all maps between them agree over cycles.

A pair alone may be ambiguous or wrong; what decides is how well a choice fits all pairs at once. So
surfaces are joined into clusters, the most certain pair first (Kruskal's order), each with a frame:
the map from the modes of the cluster's first surface, the latent space, to its own. Two clusters
are joined by one map T between their latent spaces. Each candidate of each matched pair across the
two suggests one, and each T implies a map for *every* pair across: ``Y_q T Y_p^T``. These are grown
anew and scored, and the T with the best mean score wins, whatever the pair that suggested it
preferred. So wrong choices of single pairs are outvoted, and cycles close by construction.

That maps factor through a latent space is the consistency of Huang, Wang and Guibas; growing them
from what it implies is akin to *Consistent ZoomOut* (both in `match_collection`). Frames are
orthogonal, as right maps nearly are: synchronisation on that group began with Pachauri, Kondor and
Singh (*Solving the multi-way matching problem by permutation synchronization*, NeurIPS 2013).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import solve_triangular
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree

from spectra_kit._core.threads import in_threads
from spectra_kit._core.types import Floats, Ints
from spectra_kit.maps.nearest import nearest_columns
from spectra_kit.maps.prepare import REFINED_K, Prepared
from spectra_kit.maps.result import MatchOptions
from spectra_kit.maps.score import scored
from spectra_kit.maps.zoomout import schedule

Pair = tuple[int, int]

#: Modes that composed maps are cut off at: those whose signs and orders a match tries. Of nine
#: animals of SMAL, the 36 maps implied had a mean error of 4.7 (hundredths of the root of the area)
#: when grown anew from 8 modes, and of 5.7 from 12; hippos joined them rightly from 8 modes alone.
LEAD = 8
_STEP = 6  # modes at a time, as maps are grown
_JUDGED = (LEAD, 24)  # the better one counts: the lowest modes of a limb are the same all around it
_COMPARED = 20  # modes in which maps are compared
_SAME = 0.1  # squared difference per mode of maps that count as one: wrong ones had 0.14 and more
_CROSSINGS = 3  # pairs across two clusters that are matched, at least, where there are as many
_SUGGESTING = 8  # pairs across that suggest how to join them, at most
_SUGGESTIONS = 6  # of each
_TESTED = 6  # pairs across that decide, besides
_FINALISTS = 6
_NEARBY = 4  # surfaces of the same cluster that a frame is fitted to
_SWEEPS = 2  # of fitting all frames in the end


class Sampled(NamedTuple):
    """The modes of a surface at its samples, and their QR factorisation."""

    rows: Floats  # (s, k)
    Q: Floats  # (s, k)
    R: Floats  # (k, k)

    @classmethod
    def of(cls, shape: Prepared, k: int) -> Sampled:
        """Return the lowest k modes."""
        rows = shape.spectrum.eigenvectors[shape.samples, :k]
        return cls(rows, *np.linalg.qr(rows))

    def fit(self, values: Floats, k: int) -> Floats:
        """Return the coefficients on k modes of functions at the samples, (c, s, d): (c, k, d)."""
        return np.asarray(solve_triangular(self.R[:k, :k], self.Q[:, :k].T) @ values)


def coupled_zoomout(source: Sampled, target: Sampled, maps: Floats, lead: int) -> Floats:
    """Return the maps, (c, k, k), grown anew from their `lead` lowest modes to all k.

    Each step is one of `bijective_zoomout`.
    """
    k = source.rows.shape[1]
    C = maps[:, :lead, :lead]
    for size, _ in schedule((lead, lead), k, _STEP):
        have = C.shape[1]
        A, B = source.rows[:, :have], target.rows[:, :have]
        to_source = nearest_columns(_columns(A @ C.transpose(0, 2, 1)), B)
        to_target = nearest_columns(_columns(B @ C), A)
        there = target.fit(source.rows[to_source, :size], size)
        back = source.fit(target.rows[to_target, :size], size)
        C = 0.5 * (there + back.transpose(0, 2, 1))
    return C


def _columns(images: Floats) -> NDArray[np.float32]:
    return images.transpose(0, 2, 1).astype(np.float32)


class Found(NamedTuple):
    """What matching a pair by itself has found, the best first."""

    maps: Floats  # (c, k, k)
    scores: Floats  # (c,)
    mirrored: Floats  # (c,), 1 for those that mirror
    convincing: bool

    def reversed(self) -> Found:
        """Return the same for the way back: right maps are nearly orthogonal."""
        return self._replace(maps=self.maps.transpose(0, 2, 1))

    def costs(self, options: MatchOptions) -> Floats:
        """Return the scores, those that mirror raised by what makes them less likely."""
        return self.scores * np.where(self.mirrored > 0, options.mirrored_by, 1.0)


class Frames(NamedTuple):
    """Maps from one latent space to each surface, and what they rest on."""

    maps: Floats  # (N, k, k)
    mirrored: NDArray[np.bool_]  # (N,), whether the surface is a mirror image of the latent space
    found: dict[Pair, Found]  # of the pairs that were matched


def apart(maps: Floats, others: Floats) -> Floats:
    """Return the squared difference per mode of maps, in their lowest modes."""
    m = _COMPARED
    return np.asarray(((maps - others)[..., :m, :m] ** 2).sum(axis=(-2, -1)) / m)


def groups(n: int, found: Mapping[Pair, Found]) -> Ints:
    """Return the group of each of n surfaces: convincing pairs connect them."""
    joining = [pair for pair, one in found.items() if one.convincing]
    i, j = np.array(joining, dtype=np.int64).reshape(-1, 2).T
    links = sparse.coo_array((np.ones(len(i)), (i, j)), shape=(n, n))
    return np.asarray(connected_components(links, directed=False)[1])


def graph(distances: Floats, neighbours: int) -> list[Pair]:
    """Return the pairs i < j of each surface and its nearest, and those that connect the rest."""
    near = np.argsort(distances + np.diag(np.full(len(distances), -1.0)), axis=1, kind="stable")
    pairs = {(i, int(j)) for i, row in enumerate(near) for j in row[1 : neighbours + 1]}
    tree = minimum_spanning_tree(np.triu(distances + 1e-12, 1))  # zeros would be no edges
    pairs |= set(zip(*(x.tolist() for x in tree.nonzero()), strict=True))
    return sorted({(min(pair), max(pair)) for pair in pairs})


class Clusters:
    """Connected surfaces that are some `distances` (N, N) apart, in clusters which grow into one.

    `matched` matches a pair, i < j.
    """

    def __init__(
        self,
        shapes: Sequence[Prepared],
        distances: Floats,
        matched: Callable[[int, int], Found],
        options: MatchOptions,
    ) -> None:
        k = min(REFINED_K, shapes[0].spectrum.k)
        self._shapes, self._distances, self._options = shapes, distances, options
        self._matched, self._found = matched, dict[Pair, Found]()
        self._samples = [Sampled.of(shape, k) for shape in shapes]
        self._frames = np.tile(np.eye(k), (len(shapes), 1, 1))
        self._mirrored = np.zeros(len(shapes))
        self._label = np.arange(len(shapes))

    def joined(self, neighbours: int, told: Callable[[int], object]) -> Frames:
        """Join all; `told` is told how many surfaces have been joined."""
        first = graph(self._distances, neighbours)
        for i, j in sorted(first, key=lambda pair: self._cost(*pair)):
            if self._label[i] != self._label[j]:
                self._join(*(np.flatnonzero(self._label == self._label[x]) for x in (i, j)))
                told(len(self._shapes) - len(np.unique(self._label)) + 1)
        for q in self._outvoted():  # the early ones were joined by few pairs; now all have a say
            others = np.flatnonzero(np.arange(len(self._shapes)) != q)
            self._join(others, np.array([q]))
        # From here on, a foreign surface bends no other.
        self._label = groups(len(self._shapes), self._found)
        for _ in range(_SWEEPS):
            self._fit(range(len(self._shapes)))
        return Frames(self._frames, self._mirrored > 0, self._found)

    def _outvoted(self) -> list[int]:
        """Return the surfaces most of whose pairs, by themselves, would map them otherwise."""
        votes = np.zeros((len(self._shapes), 2))
        for (i, j), found in self._found.items():
            if found.convincing:
                other = apart(found.maps[0], self._frames[j] @ self._frames[i].T) > _SAME
                votes[[i, j], int(other)] += 1
        return [int(q) for q in np.flatnonzero(votes[:, 1] > votes[:, 0])]

    def _pair(self, i: int, j: int) -> Found:
        """Return what is found for the pair, matched if it is not yet."""
        if i > j:
            return self._pair(j, i).reversed()
        if (i, j) not in self._found:
            self._found[i, j] = self._matched(i, j)
        return self._found[i, j]

    def _cost(self, i: int, j: int) -> float:
        return float(self._pair(i, j).costs(self._options).min())

    def _join(self, one: Ints, other: Ints) -> None:
        """Join two clusters: those of the smaller one move to the latent space of the larger."""
        into, moved = (one, other) if len(one) >= len(other) else (other, one)
        across = [(int(p), int(q)) for p in into for q in moved]
        nearest = sorted(across, key=lambda pair: self._distances[pair])
        known = {pair for pair in across if (min(pair), max(pair)) in self._found}
        matched = sorted(known | set(nearest[:_CROSSINGS]), key=lambda pair: self._cost(*pair))
        maps, mirrored = self._suggested(matched[:_SUGGESTING])
        deciding = list(dict.fromkeys(matched[:_CROSSINGS] + nearest[:_TESTED]))
        costs, means = self._judged(maps, mirrored, deciding, rough=True)
        best = np.argsort(costs, kind="stable")[:_FINALISTS]
        maps, mirrored = means[best], mirrored[best]
        costs, _ = self._judged(maps, mirrored, deciding, rough=False)
        chosen = int(costs.argmin())
        self._frames[moved] = _orthogonal(self._frames[moved] @ maps[chosen])
        self._mirrored[moved] = (self._mirrored[moved] + mirrored[chosen]) % 2
        self._label[moved] = self._label[into[0]]
        self._fit(moved.tolist())

    def _suggested(self, pairs: Iterable[Pair]) -> tuple[Floats, Floats]:
        """Return what candidates of pairs across suggest, (c, k, k), and which of it mirrors."""
        maps, mirrored = list[Floats](), list[float]()
        for p, q in pairs:
            found = self._pair(p, q)
            for c in np.argsort(found.costs(self._options), kind="stable")[:_SUGGESTIONS]:
                between = self._frames[q].T @ found.maps[c] @ self._frames[p]
                if all(apart(between, other) > _SAME for other in maps):
                    maps.append(between)
                    turns = found.mirrored[c] + self._mirrored[p] + self._mirrored[q]
                    mirrored.append(float(turns % 2))
        return np.array(maps), np.array(mirrored)

    def _judged(
        self, maps: Floats, mirrored: Floats, pairs: Sequence[Pair], *, rough: bool
    ) -> tuple[Floats, Floats]:
        """Return mean log scores of what each T implies, (c,), and the T that fits that best."""
        frames = self._frames

        def judge(p: int, q: int) -> tuple[Floats, Floats]:
            turns = (mirrored + self._mirrored[p] + self._mirrored[q]) % 2 > 0
            implied = frames[q] @ maps @ frames[p].T
            grown = np.stack([self._grown(p, q, implied, lead) for lead in _JUDGED])
            logs = np.array(
                [
                    [self._log_cost(p, q, *one, rough) for one in zip(C, turns, strict=True)]
                    for C in grown
                ]
            )
            best, every = logs.argmin(axis=0), np.arange(len(maps))
            return logs[best, every], frames[q].T @ grown[best, every] @ frames[p]

        logs, fits = zip(*in_threads(judge, pairs), strict=True)
        return np.mean(logs, axis=0), np.mean(fits, axis=0)

    def _grown(self, p: int, q: int, maps: Floats, lead: int = LEAD) -> Floats:
        return coupled_zoomout(self._samples[p], self._samples[q], maps, lead)

    def _log_cost(self, p: int, q: int, C: Floats, mirrored: bool, rough: bool) -> float:
        found = scored(self._shapes[p], self._shapes[q], C, mirrored, rough=rough)
        # A map that was to keep the sides may turn them over as it grows.
        turned = mirrored or found.mismatches.get("orientation", 0.0) > 0.5
        return float(np.log(found.score * (self._options.mirrored_by if turned else 1.0)))

    def _fit(self, members: Iterable[int]) -> None:
        """Fit each frame to those of the nearest surfaces of its cluster."""
        for q in members:
            fellows = np.flatnonzero(self._label == self._label[q])
            fellows = fellows[fellows != q]
            near = fellows[np.argsort(self._distances[q, fellows], kind="stable")[:_NEARBY]]
            if len(near):
                fits = in_threads(self._carried, ((int(p), q) for p in near))
                self._frames[q] = _orthogonal(np.mean(fits, axis=0))

    def _carried(self, p: int, q: int) -> Floats:
        """Return the frame of q that follows from that of p."""
        implied = self._frames[q] @ self._frames[p].T
        return np.asarray(self._grown(p, q, implied[None])[0] @ self._frames[p])


def _orthogonal(maps: Floats) -> Floats:
    """Return the orthogonal matrix nearest to each of (..., k, k)."""
    left, _, right = np.linalg.svd(maps)
    return np.asarray(left @ right)
