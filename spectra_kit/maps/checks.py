"""Checks of maps between two spectra; the public functions pass their arguments through here."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_count, check_indices, real_array
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError

_START = 20  # modes with which a point map starts: enough to tell the limbs of a body apart


def check_point_map(
    name: str, values: ArrayLike, n_source: int, n_target: int | None = None
) -> Ints:
    """Return `values` as the source point of each target point: int64 of shape (n_target,)."""
    shape = np.shape(values)
    if len(shape) != 1 or (n_target is not None and shape != (n_target,)):
        backwards = n_source != n_target and shape == (n_source,)
        hint = " (it seems to run from source to target)" if backwards else ""
        raise InvalidInputError(
            name,
            f"have shape ({n_target or 'n2'},), the source point of each target point",
            f"{shape}{hint}",
        )
    return check_indices(name, values, n_source)


def check_functional_map(
    name: str, values: ArrayLike, source: Spectrum, target: Spectrum
) -> Floats:
    """Return `values` as finite float64 of shape (k2, k1), within the modes of the spectra."""
    shape = np.shape(values)
    if len(shape) != 2 or not (1 <= shape[0] <= target.k and 1 <= shape[1] <= source.k):
        raise InvalidInputError(
            name,
            f"have shape (k2, k1) with k2 of the target's {target.k} modes and k1 of the"
            f" source's {source.k}",
            shape,
            advice="compute more modes or truncate the map",
        )
    return real_array(name, values)


def check_sizes(
    k: int | tuple[int, int] | None, source: Spectrum, target: Spectrum
) -> tuple[int, int]:
    """Return (k1, k2) from one number for both, one for each, or None for all modes."""
    k1, k2 = (source.k, target.k) if k is None else (k, k) if not isinstance(k, tuple) else k
    return (
        check_count("k of the source", k1, low=1, high=source.k),
        check_count("k of the target", k2, low=1, high=target.k),
    )


def check_components(source: Spectrum, target: Spectrum) -> None:
    """Refuse two surfaces whose kernels differ: their modes cannot correspond one to one."""
    a, b = source.n_zero_modes, target.n_zero_modes
    if a != b:
        raise InvalidInputError(
            "`source` and `target` must have the same number of components, got"
            f" {a} and {b} zero modes; match component by component"
            " (geometry.components)"
        )


def at_unit_area(spectrum: Spectrum) -> Spectrum:
    """Return the spectrum of the surface scaled to area 1."""
    area = spectrum.area
    return spectrum if abs(area - 1.0) < 1e-12 else spectrum.rescale(area**-0.5)


def starting_map(a: Spectrum, b: Spectrum, initial: ArrayLike, k_start: int | None) -> Floats:
    """Return the functional map to start from, of at most the modes of the spectra."""
    if np.ndim(initial) == 1:
        k = min(_START, a.k, b.k) if k_start is None else k_start
        check_count("k_start", k, low=1, high=min(a.k, b.k))
        point_map = check_point_map("initial", initial, a.n, b.n)
        return b.truncate(k).project(a.eigenvectors[point_map, :k])
    if np.ndim(initial) == 2 and max(np.shape(initial)) > min(a.k, b.k):
        raise InvalidInputError(
            "k_final",
            f"be at least the size of `initial`, {np.shape(initial)}",
            min(a.k, b.k),
            advice="end later, or cut `initial`",
        )
    C = check_functional_map("initial", initial, a, b)
    if k_start is None:
        return C
    check_count("k_start", k_start, low=1, high=min(C.shape))
    return C[:k_start, :k_start]


def checked_pair(source: Spectrum, target: Spectrum, k: int) -> tuple[Spectrum, Spectrum]:
    """Return the first `k` modes of both, at unit area; refuse pairs that cannot be refined."""
    check_components(source, target)
    check_count("k_final", k, low=1)
    if k > min(source.k, target.k):
        raise InvalidInputError(
            "k_final",
            f"be at most {min(source.k, target.k)}",
            f"{k}: the source has {source.k} modes, the target {target.k}",
            advice="compute more modes or end sooner",
        )
    return at_unit_area(source.truncate(k)), at_unit_area(target.truncate(k))


def checked_samples(
    samples: int | tuple[ArrayLike, ArrayLike], n1: int, n2: int, k_final: int, seed: int
) -> tuple[Ints, Ints]:
    """Return the source and the target points to work on: given, or chosen at random."""
    if isinstance(samples, int | np.integer):
        count = check_count("samples", samples, low=k_final)
        rng = np.random.default_rng(check_count("seed", seed, low=0))
        first, second = (
            np.sort(rng.choice(n, min(count, n), replace=False)).astype(np.int64) for n in (n1, n2)
        )
        return first, second
    if not isinstance(samples, tuple | list) or len(samples) != 2:
        raise InvalidInputError(
            "samples",
            "be a number, or two arrays of indices (of the source, of the target)",
            f"a {type(samples).__name__}",
        )
    for i in range(2):
        if np.ndim(samples[i]) != 1 or np.size(samples[i]) == 0:
            raise InvalidInputError(
                f"samples[{i}]", "be a non-empty list of indices", f"shape {np.shape(samples[i])}"
            )
    first = check_indices("samples[0]", samples[0], n1)
    second = check_indices("samples[1]", samples[1], n2)
    distinct = len(np.unique(second))
    if distinct < k_final:
        raise InvalidInputError(
            "samples[1]",
            f"hold at least `k_final` = {k_final} distinct points",
            distinct,
            advice="sample more or end sooner",
        )
    return first, second
