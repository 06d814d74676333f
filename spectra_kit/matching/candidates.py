"""Candidate maps: every choice of signs for the lowest modes, each grown with an eye on the side.

A near-isometric pair leaves the signs of the lowest modes open (Ren et al. 2020 explore them as a
tree). Each choice is one candidate: a diagonal map of six modes, which ZoomOut (Melzi et al. 2019)
grows on some two hundred samples. Growing alone turns many candidates front to back, because the
lowest modes of a limb are the same all around it. So two kinds of functions join the modes:

- the area forms ``n . (grad f_a x grad f_b)`` of mapped pairs of low modes. They change sign where
  a map turns the surface over, and hence hold it to one orientation. They are the orientation term
  of Ren et al. (2018), written for the modes themselves in place of descriptors;
- the smoothed mean curvature, which differs between the front and the back of a limb.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from spectra_kit.matching.prepare import Prepared

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SIGNED = 6  # modes whose signs are tried, the constant aside: 2^5 candidates
GROWN = 30  # modes that a candidate is grown to
_SAMPLES = 200
_FORMS = 8  # modes whose area forms are compared
_FORMS_UNTIL = 20  # modes from which a map holds its orientation by itself
_FORM_SHARE = 0.5  # squared length of the area forms, relative to that of the modes
_CURVATURE_SHARE = 0.1  # the same for curvature
_COARSE = slice(0, 3)  # of the smoothed curvatures


def sign_candidates(source: Prepared, target: Prepared, *, reversing: bool = False) -> Floats:
    """Return candidate functional maps, grown from all signs of the lowest modes.

    Parameters
    ----------
    source, target : Prepared
        The surfaces.
    reversing : bool, default False
        Look for maps that turn the surface over, like a mirror. Needs both geometries.

    Returns
    -------
    ndarray of shape (32, 30, 30)
        One functional map (k2, k1) of source to target for each choice of signs.
    """
    first, second = source.samples[:_SAMPLES], target.samples[:_SAMPLES]
    a, b = source.spectrum, target.spectrum
    rows1, rows2 = a.eigenvectors[first, :GROWN], b.eigenvectors[second, :GROWN]
    curved = _curvatures(source, target, first, second)
    forms = _form_values(source, target, first, second, reversing)
    constant = np.sign(a.eigenvectors[0, 0] * b.eigenvectors[0, 0])
    signs = np.array([(constant, *s) for s in product((1.0, -1.0), repeat=SIGNED - 1)])
    maps: Floats = signs[:, :, None] * np.eye(SIGNED)
    Q, R = np.linalg.qr(rows2)
    for k in range(SIGNED, GROWN + 1):
        columns1 = [rows1[:, :k] @ maps.transpose(0, 2, 1)]
        columns2 = [rows2[:, :k]]
        if forms is not None and k < _FORMS_UNTIL:
            weight = np.sqrt(_FORM_SHARE * k / forms.target.shape[1])
            columns1.append(weight * forms.mapped(maps))
            columns2.append(weight * forms.target)
        if curved is not None:
            weight = np.sqrt(_CURVATURE_SHARE * k / curved[1].shape[1])
            columns1.append(np.broadcast_to(weight * curved[0], (len(maps), *curved[0].shape)))
            columns2.append(weight * curved[1])
        nearest = _nearest_each(np.concatenate(columns1, axis=2), np.hstack(columns2))
        k_next = min(k + 1, GROWN)
        fit = solve_triangular(R[:k_next, :k_next], Q[:, :k_next].T)
        maps = fit @ rows1[nearest][:, :, :k_next]
    return maps


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
        turned = C[:, None] @ self.source[None, :, :m, :m] @ C.transpose(0, 2, 1)[:, None]
        out: Floats = turned[:, :, self.pairs[0], self.pairs[1]] / self.scale
        return out


def _form_values(
    source: Prepared, target: Prepared, first: Ints, second: Ints, reversing: bool
) -> _Forms | None:
    """Return the area forms at the samples, or None without both geometries."""
    if source.surface is None or target.surface is None:
        return None
    values = [
        np.einsum(
            "sl,lij->sij",
            side.spectrum.eigenvectors[chosen, : len(form)],
            form[:, :_FORMS, :_FORMS],
        )
        for side, form, chosen in (
            (source, source.surface.form, first),
            (target, target.surface.form, second),
        )
    ]
    i, j = np.triu_indices(_FORMS, 1)
    pairs = (i[i > 0], j[i > 0])  # those with the constant vanish
    on_target = values[1][:, pairs[0], pairs[1]]
    scale = np.sqrt((on_target**2).mean(axis=0))
    return _Forms(values[0], (-on_target if reversing else on_target) / scale, scale, pairs)


def _curvatures(
    source: Prepared, target: Prepared, first: Ints, second: Ints
) -> tuple[Floats, Floats] | None:
    """Return the coarser curvatures at the samples; None without both geometries."""
    if source.surface is None or target.surface is None:
        return None
    return source.surface.curvature[first, _COARSE], target.surface.curvature[second, _COARSE]


def _nearest_each(rows1: Floats, rows2: Floats) -> Ints:
    """Return the nearest of the source's rows (c, s1, d) to each of the target's (s2, d)."""
    images = rows1.astype(np.float32).transpose(0, 2, 1)
    scores = rows2.astype(np.float32) @ images
    scores -= 0.5 * (images**2).sum(axis=1)[:, None]
    return np.asarray(scores.argmax(axis=2))
