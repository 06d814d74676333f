"""Laying one surface onto another: turned copies, mirror images, normals from modes."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import creature

from spectra_kit import eigensolve, prepare, robust_laplacian
from spectra_kit.geometry import TriangleMesh, mirrored
from spectra_kit.maps import MatchOptions, Prepared
from spectra_kit.maps.alignment import SAMPLES, bent, placed_candidates, side_of
from spectra_kit.maps.curvature import outward_normals


@pytest.fixture(scope="module")
def mesh() -> TriangleMesh:
    return creature(900)


@pytest.fixture(scope="module")
def source(mesh) -> Prepared:
    return prepare(eigensolve(robust_laplacian(mesh), 70), mesh)


def turned(mesh: TriangleMesh, source: Prepared, *, image: bool = False) -> Prepared:
    """Elsewhere, in another unit, with the modes of the source."""
    made = mirrored(mesh) if image else mesh
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    made = TriangleMesh(2.5 * made.points @ turn + [3.0, -1.0, 2.0], made.faces)
    return prepare(source.spectrum.rescale(2.5 * np.sqrt(mesh.area)), made)


@pytest.mark.parametrize("image", [False, True])
def test_a_turned_copy_lies_on_its_source(mesh, source, image) -> None:
    """Nothing is known of how the two lie: the first candidate is the identity, all but exact."""
    sides = (
        side_of(source, mirrored=image),
        side_of(turned(mesh, source, image=image)),
    )
    C = placed_candidates(*sides, MatchOptions().turns)[0]
    assert np.linalg.norm(C - np.eye(30)) < 0.05 * np.sqrt(30)
    made = bent(*sides, C)
    assert made.functional_map == pytest.approx(np.eye(60), abs=1e-8)
    assert made.distance < 1e-6


def test_normals_of_modes_are_those_of_triangles(source) -> None:
    """With more modes they come nearer: these leave out what is smaller than a limb."""
    side, surface = side_of(source), source.surface
    chosen = source.samples[:SAMPLES]
    points = surface.points - surface.mass @ surface.points
    axes = np.linalg.lstsq(points, source.spectrum.eigenvectors @ side.positions, rcond=None)[0]
    exact = outward_normals(surface.points, surface.oriented)[chosen] @ axes
    agree = [
        float((side.bent_normals(side.positions[:k]) * exact).sum(axis=1).mean()) for k in (8, 40)
    ]
    assert agree[0] < agree[1]
    assert agree[1] > 0.85
