"""Candidate maps: all signs and likely orders of the lowest modes, grown with their orientation.

A near-isometric pair leaves the signs of the lowest modes open, and the order of those whose
eigenvalues are close (Ren et al. 2020 explore both as a tree). Each choice is one candidate: a
signed permutation of seven modes. Those that fit best on a few samples are grown on two hundred,
by ZoomOut (Melzi et al. 2019), and fewer and fewer go on. Growing alone turns many candidates front
to back, because the lowest modes of a limb are the same all around it. So two kinds of functions
join the modes:

- the area forms ``n . (grad f_a x grad f_b)`` of mapped pairs of low modes. They change sign where
  a map turns the surface over, and hence hold it to one orientation. They are the orientation term
  of Ren et al. (2018), written for the modes themselves in place of descriptors;
- the smoothed mean curvature, which differs between the front and the back of a limb.
"""

from __future__ import annotations

from itertools import permutations, product
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from spectra_kit._types import Floats, Ints
from spectra_kit.matching.options import DEFAULT, MatchOptions
from spectra_kit.matching.prepare import Prepared, curvatures
from spectra_kit.spectra import Spectrum


def sign_candidates(
    source: Prepared,
    target: Prepared,
    *,
    mirrored: bool = False,
    options: MatchOptions = DEFAULT,
) -> Floats:
    """Return functional maps, (16, 30, 30), grown from all signs and likely orders of low modes.

    They are those that fit best on the way; with `mirrored`, which needs both geometries, of those
    that mirror.
    """
    first, second = (side.samples[: options.growing_samples] for side in (source, target))
    a, b = source.spectrum, target.spectrum
    samples = _Samples(
        a.eigenvectors[first, : options.grown_modes],
        b.eigenvectors[second, : options.grown_modes],
        _form_values(source, target, first, second, mirrored, options),
        _curvatures(source, target, first, second, options),
        options,
    )
    maps, kept = _starts(a, b, options), dict(options.kept)
    _, fits = samples.head(options.first_samples).nearest(maps)
    maps = maps[_best(fits, options.growing)]
    Q, R = np.linalg.qr(samples.rows2)
    for k in range(options.signed_modes, options.grown_modes + 1):
        nearest, fits = samples.nearest(maps)
        if k in kept:
            nearest = nearest[_best(fits, kept[k])]
        k_next = min(k + 1, options.grown_modes)
        fit = solve_triangular(R[:k_next, :k_next], Q[:, :k_next].T)
        maps = fit @ samples.rows1[:, :k_next][nearest]
    return maps


def _best(fits: Floats, count: int) -> Ints:
    """Return which fit best, the best first."""
    return np.argsort(-fits, kind="stable")[:count]


def _starts(a: Spectrum, b: Spectrum, options: MatchOptions) -> Floats:
    """Return signed permutations of the lowest modes, (c, 7, 7): all signs, likely orders.

    An order is the likelier, the less the logarithms of the eigenvalues that it pairs differ.
    """
    m = options.signed_modes
    logs1, logs2 = np.log(a.eigenvalues[1:m]), np.log(b.eigenvalues[1:m])
    orders = np.array(list(permutations(range(m - 1))))
    differ = ((logs1[orders] - logs2) ** 2).sum(axis=1)
    orders = 1 + orders[np.argsort(differ, kind="stable")[: options.orders]]
    ordered = np.eye(m)[np.insert(orders, 0, 0, axis=1)]
    constant = np.sign(a.eigenvectors[0, 0] * b.eigenvectors[0, 0])
    signs = np.array([(constant, *s) for s in product((1.0, -1.0), repeat=m - 1)])
    starts: Floats = (signs[:, None, :, None] * ordered).reshape(-1, m, m)
    return starts


class _Forms(NamedTuple):
    """Area forms of the lowest modes at samples, scaled to those of the target."""

    source: Floats  # (s1, m, m)
    target: Floats  # (s2, pairs)
    scale: Floats  # (pairs,)
    pairs: tuple[Ints, Ints]

    def mapped(self, maps: Floats) -> Floats:
        """Return the forms of the mapped modes at the source's samples, (c, s1, pairs)."""
        m = min(len(self.source[0]), maps.shape[1])
        C = np.zeros((len(maps), len(self.source[0]), m))
        C[:, :m] = maps[:, :m, :m]
        c, q, s = len(maps), len(self.source[0]), len(self.source)
        half = C @ self.source[:, :m, :m].transpose(1, 0, 2).reshape(m, s * m)
        turned = (half.reshape(c, q * s, m) @ C.transpose(0, 2, 1)).reshape(c, q, s, q)
        out: Floats = turned.transpose(0, 2, 1, 3)[:, :, self.pairs[0], self.pairs[1]] / self.scale
        return out


class _Samples(NamedTuple):
    """What maps are compared by, at samples of both surfaces."""

    rows1: Floats  # (s1, 30) modes of the source
    rows2: Floats  # (s2, 30) and of the target
    forms: _Forms | None
    curved: tuple[Floats, Floats] | None
    options: MatchOptions

    def head(self, count: int) -> _Samples:
        """Return the first samples."""
        forms, curved = self.forms, self.curved
        if forms is not None:
            forms = forms._replace(source=forms.source[:count], target=forms.target[:count])
        if curved is not None:
            curved = (curved[0][:count], curved[1][:count])
        return self._replace(
            rows1=self.rows1[:count], rows2=self.rows2[:count], forms=forms, curved=curved
        )

    def nearest(self, maps: Floats) -> tuple[Ints, Floats]:
        """Return the source's sample nearest to each of the target's, (c, s2), and the fit (c,).

        The fit is the sum of ``row2 . row1 - |row1|^2 / 2``: the larger, the nearer they are.
        """
        k, options = maps.shape[1], self.options
        columns1 = [self.rows1[:, :k] @ maps.transpose(0, 2, 1)]
        columns2 = [self.rows2[:, :k]]
        if self.forms is not None and k < options.forms_until:
            weight = np.sqrt(options.form_share * k / self.forms.target.shape[1])
            columns1.append(weight * self.forms.mapped(maps))
            columns2.append(weight * self.forms.target)
        if self.curved is not None:
            on_source, on_target = self.curved
            weight = np.sqrt(options.curvature_share * k / on_target.shape[1])
            columns1.append(np.broadcast_to(weight * on_source, (len(maps), *on_source.shape)))
            columns2.append(weight * on_target)
        images = np.concatenate(columns1, axis=2, dtype=np.float32).transpose(0, 2, 1)
        scores = np.concatenate(columns2, axis=1, dtype=np.float32) @ images
        scores -= 0.5 * (images**2).sum(axis=1)[:, None]
        return scores.argmax(axis=2), scores.max(axis=2).sum(axis=1)


def _form_values(
    source: Prepared,
    target: Prepared,
    first: Ints,
    second: Ints,
    mirrored: bool,
    options: MatchOptions = DEFAULT,
) -> _Forms | None:
    """Return the area forms at the samples, or None without both geometries."""
    if source.surface is None or target.surface is None:
        return None
    m = options.form_modes
    values = [
        np.einsum(
            "sl,lij->sij",
            side.spectrum.eigenvectors[chosen, : len(form)],
            form[:, :m, :m],
        )
        for side, form, chosen in (
            (source, source.surface.form, first),
            (target, target.surface.form, second),
        )
    ]
    i, j = np.triu_indices(m, 1)
    pairs = (i[i > 0], j[i > 0])  # those with the constant vanish
    on_target = values[1][:, pairs[0], pairs[1]]
    scale = np.sqrt((on_target**2).mean(axis=0))
    return _Forms(values[0], (-on_target if mirrored else on_target) / scale, scale, pairs)


def _curvatures(
    source: Prepared, target: Prepared, first: Ints, second: Ints, options: MatchOptions
) -> tuple[Floats, Floats] | None:
    """Return the finer curvatures at the samples, where they can be compared."""
    both = curvatures(source, target)
    few = options.growing_curvatures
    return both and (both[0][first, :few], both[1][second, :few])
