"""Joints that bend a mesh with little stretch: how the demo animal takes another pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from spectra_kit._types import Floats


@dataclass(frozen=True, eq=False)
class Joint:
    """A place to bend at.

    Attributes
    ----------
    pivot : ndarray of shape (3,)
        The centre of the turn, at rest.
    limits : ndarray of shape (3,)
        Largest angle about each axis, in radians.
    weight : ndarray of shape (n,)
        How much of the turn each point takes part in: 1 beyond the joint, 0 before it.
    """

    pivot: Floats
    limits: Floats
    weight: Floats


def ramp(values: Floats, width: float) -> Floats:
    """Rise smoothly from 0 at -width to 1 at +width."""
    t = np.clip(0.5 + 0.5 * values / width, 0.0, 1.0)
    return np.asarray(t * t * (3 - 2 * t))


def bend(points: Floats, joints: Sequence[Joint], rng: np.random.Generator) -> Floats:
    """Turn every joint by a random angle; joints nearer to the tips come first.

    A point turns by its share of the *angle*, not towards a mean of two positions, so that limbs
    keep their thickness at a joint.
    """
    from scipy.spatial.transform import Rotation

    moved = points
    for joint in joints:
        turn = joint.limits * rng.uniform(-1, 1, 3)
        turns = Rotation.from_rotvec(joint.weight[:, None] * turn)
        moved = joint.pivot + turns.apply(moved - joint.pivot)
    return moved
