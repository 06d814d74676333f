"""Surfaces of several parts: which is which, and which has no partner."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import creature, refused
from test_match import QUICK

from spectra_kit import TriangleMesh
from spectra_kit.errors import DoubtfulMatchWarning, InvalidInputError
from spectra_kit.geometry import components, permuted, sphere, torus
from spectra_kit.maps import match, match_components

RING = torus(n=500, major=1.0, minor=0.4).geometry
SPECK = sphere(subdivisions=1).geometry


def beside(*meshes: TriangleMesh) -> TriangleMesh:
    """One surface of these parts, each three further along x."""
    first = np.cumsum([0, *(mesh.n for mesh in meshes)])
    points = [mesh.points + [3.0 * i, 0, 0] for i, mesh in enumerate(meshes)]
    faces = [mesh.faces + n for mesh, n in zip(meshes, first, strict=False)]
    return TriangleMesh(np.vstack(points), np.vstack(faces))


def test_each_part_gets_its_own_in_any_order_and_place() -> None:
    """Of two animals, a copy of each, in other sizes: every point comes home."""
    one, other = creature(500, pose=1, seed=1), creature(600, pose=0, seed=4)
    (copy, truth), (larger, also) = permuted(one, seed=2), permuted(other, seed=3)
    larger = larger.with_points(3 * larger.points)
    found = match_components(beside(one, other), beside(larger, copy), k=60, options=QUICK)
    np.testing.assert_array_equal(found.partner, [1, 0])
    assert set(found.matches) == {(1, 0), (0, 1)}
    assert (found.confidence > 0.5).all()
    np.testing.assert_array_equal(found.point_map, np.concatenate([500 + also, truth]))


def test_what_has_no_partner_gets_none() -> None:
    """A ring beside an animal, a speck, and points of no face."""
    animal = creature(500)
    scene = beside(SPECK, animal, RING)
    scene = TriangleMesh(np.vstack([scene.points, [[9.0, 9, 9]]]), scene.faces)
    source = beside(creature(500, pose=1), SPECK, creature(600, pose=2))
    with pytest.warns(DoubtfulMatchWarning) as told:
        found = match_components(source, scene, k=60, mirrored=False, options=QUICK)
    where = f"part {2 - found.partner[1]} of the source and part 2 of the target"
    assert [warning.message.where for warning in told] == [where]
    assert str(told[0].message).startswith(f"{where}: no convincing map")
    assert found.partner[0] == found.partner[2] == -1
    assert found.partner[1] in (0, 2)
    assert found.confidence[0] == 0
    of_animal = np.isin(np.arange(scene.n), components(scene)[1].vertex_index)
    assert (found.point_map[~of_animal] == -1).all()
    partner = components(source)[found.partner[1]].vertex_index
    assert np.isin(found.point_map[of_animal], partner).all()
    assert repr(found) == "ComponentMatch(1 parts with a partner, 2 without)"


def test_warnings_of_a_part_say_which_one_it_is() -> None:
    """One face of the animal behind a speck is wound against the others."""
    animal = creature(500)
    turned = TriangleMesh(animal.points, np.vstack([animal.faces[:1, ::-1], animal.faces[1:]]))
    with pytest.warns(DoubtfulMatchWarning, match="^part 1 of the target: ") as told:
        match_components(animal, beside(SPECK, turned), k=60, mirrored=False, options=QUICK)
    assert len(told) == 1


def test_a_part_without_area_has_no_partner() -> None:
    """Points on a line, in triangles: the animal beside it is found all the same."""
    i = np.arange(150.0)
    line = TriangleMesh(
        np.outer(i, [0.01, 0, 0]), np.column_stack([i[:-2], i[1:-1], i[2:]]).astype(int)
    )
    animal = creature(500)
    found = match_components(animal, beside(line, animal), k=60, mirrored=False, options=QUICK)
    np.testing.assert_array_equal(found.partner, [-1, 0])


def test_whoever_matches_several_parts_as_one_is_told() -> None:
    with pytest.raises(InvalidInputError, match=r"each with its own, by maps\.match_components"):
        match(RING, beside(RING, SPECK))


def test_specks_alone_are_refused() -> None:
    refused("target", "have a part of 100 points or more, got 42", match_components, RING, SPECK)
