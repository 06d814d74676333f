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

from spectra_kit._core.types import Floats, Ints
from spectra_kit.eigen import Spectrum
from spectra_kit.maps.options import DEFAULT, MatchOptions
from spectra_kit.maps.prepare import LOWEST_K, Prepared, curvatures

#: How many of the smoothed curvatures candidates grow by, from the finest.
GROWING_CURVATURES = 3
_SIGNED = 7  # modes whose signs are tried, the constant among them: 2^6 choices
_FIRST_SAMPLES = 48  # on which these are compared
_SAMPLES = 200  # on which they grow
_FORM_MODES = 8  # whose area forms are compared
_FORMS_UNTIL = 20  # modes from which a map holds its orientation by itself, without area forms
_FORM_SHARE = 0.5  # squared length of the area forms, relative to that of the modes
_CURVATURE_SHARE = 0.1  # the same for curvature


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
    samples = _sampled(source, target, mirrored)
    maps, kept = _starts(source.spectrum, target.spectrum, options.orders), dict(options.kept)
    _, fits = samples.head(_FIRST_SAMPLES).nearest(maps)
    maps = maps[_best(fits, options.growing)]
    Q, R = np.linalg.qr(samples.rows2)
    for k in range(_SIGNED, LOWEST_K + 1):
        nearest, fits = samples.nearest(maps)
        if k in kept:
            nearest = nearest[_best(fits, kept[k])]
        k_next = min(k + 1, LOWEST_K)
        fit = solve_triangular(R[:k_next, :k_next], Q[:, :k_next].T)
        maps = fit @ samples.rows1[:, :k_next][nearest]
    return maps


def _best(fits: Floats, count: int) -> Ints:
    """Return which fit best, the best first."""
    return np.argsort(-fits, kind="stable")[:count]


def _starts(a: Spectrum, b: Spectrum, count: int) -> Floats:
    """Return signed permutations of the lowest modes, (c, 7, 7): all signs, so many likely orders.

    An order is the likelier, the less the logarithms of the eigenvalues that it pairs differ.
    """
    m = _SIGNED
    logs1, logs2 = np.log(a.eigenvalues[1:m]), np.log(b.eigenvalues[1:m])
    orders = np.array(list(permutations(range(m - 1))))
    differ = ((logs1[orders] - logs2) ** 2).sum(axis=1)
    orders = 1 + orders[np.argsort(differ, kind="stable")[:count]]
    ordered = np.eye(m)[np.insert(orders, 0, 0, axis=1)]
    constant = np.sign(a.eigenvectors[0, 0] * b.eigenvectors[0, 0])
    signs = np.array([(constant, *s) for s in product((1.0, -1.0), repeat=m - 1)])
    starts: Floats = (signs[:, None, :, None] * ordered).reshape(-1, m, m)
    return starts


class _Samples(NamedTuple):
    """What maps are compared by, at samples of both surfaces; None without the geometries."""

    scale: Floats | None  # (pairs,) of the target's area forms
    rows1: Floats  # (s1, 30) modes of the source
    rows2: Floats  # (s2, 30) and of the target
    forms1: Floats | None  # (s1, m, m) area forms of the lowest modes
    forms2: Floats | None  # (s2, pairs), scaled
    curved1: Floats | None  # (s1, c) curvatures
    curved2: Floats | None  # (s2, c)

    def head(self, count: int) -> _Samples:
        """Return the first samples."""
        names = ("rows1", "rows2", "forms1", "forms2", "curved1", "curved2")
        known = {name: x for name in names if (x := getattr(self, name)) is not None}
        return self._replace(**{name: x[:count] for name, x in known.items()})

    def nearest(self, maps: Floats) -> tuple[Ints, Floats]:
        """Return the source's sample nearest to each of the target's, (c, s2), and the fit (c,).

        The fit is the sum of ``row2 . row1 - |row1|^2 / 2``: the larger, the nearer they are.
        """
        k = maps.shape[1]
        columns1 = [self.rows1[:, :k] @ maps.transpose(0, 2, 1)]
        columns2 = [self.rows2[:, :k]]
        if self.forms2 is not None and k < _FORMS_UNTIL:
            weight = np.sqrt(_FORM_SHARE * k / self.forms2.shape[1])
            columns1.append(weight * self._mapped_forms(maps))
            columns2.append(weight * self.forms2)
        if self.curved1 is not None and self.curved2 is not None:
            weight = np.sqrt(_CURVATURE_SHARE * k / self.curved2.shape[1])
            there = weight * self.curved1
            columns1.append(np.broadcast_to(there, (len(maps), *there.shape)))
            columns2.append(weight * self.curved2)
        images = np.concatenate(columns1, axis=2, dtype=np.float32).transpose(0, 2, 1)
        scores = np.concatenate(columns2, axis=1, dtype=np.float32) @ images
        scores -= 0.5 * (images**2).sum(axis=1)[:, None]
        return scores.argmax(axis=2), scores.max(axis=2).sum(axis=1)

    def _mapped_forms(self, maps: Floats) -> Floats:
        """Return the forms of the mapped modes at the source's samples, (c, s1, pairs)."""
        forms = np.asarray(self.forms1)
        c, s, q = len(maps), *forms.shape[:2]
        m = min(q, maps.shape[1])
        C = np.zeros((c, q, m))
        C[:, :m] = maps[:, :m, :m]
        half = C @ forms[:, :m, :m].transpose(1, 0, 2).reshape(m, s * m)
        turned = (half.reshape(c, q * s, m) @ C.transpose(0, 2, 1)).reshape(c, q, s, q)
        i, j = _pairs(q)
        return np.asarray(turned.transpose(0, 2, 1, 3)[:, :, i, j] / self.scale)


def _sampled(source: Prepared, target: Prepared, mirrored: bool) -> _Samples:
    """Return what candidates of one orientation grow by."""
    first, second = (side.samples[:_SAMPLES] for side in (source, target))
    forms1 = forms2 = scale = curved1 = curved2 = None
    if source.surface is not None and target.surface is not None:
        m = _FORM_MODES
        forms1, on_target = (
            np.einsum(
                "sl,lij->sij",
                side.spectrum.eigenvectors[chosen, : len(form)],
                form[:, :m, :m],
            )
            for side, form, chosen in (
                (source, source.surface.form, first),
                (target, target.surface.form, second),
            )
        )
        i, j = _pairs(m)
        forms2 = on_target[:, i, j]
        scale = np.sqrt((forms2**2).mean(axis=0))
        forms2 = (-forms2 if mirrored else forms2) / scale
    if both := curvatures(source, target):
        curved1, curved2 = (
            curved[chosen, :GROWING_CURVATURES]
            for curved, chosen in zip(both, (first, second), strict=True)
        )
    rows1 = source.spectrum.eigenvectors[first, :LOWEST_K]
    rows2 = target.spectrum.eigenvectors[second, :LOWEST_K]
    return _Samples(scale, rows1, rows2, forms1, forms2, curved1, curved2)


def _pairs(m: int) -> tuple[Ints, Ints]:
    """Return the pairs i < j of m modes whose area form may be other than 0: not the constant."""
    i, j = np.triu_indices(m, 1)
    return i[i > 0], j[i > 0]
