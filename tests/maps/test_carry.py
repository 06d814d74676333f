"""What is carried along maps: nothing changes along the identity, rings and affine maps by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import bumpy, creature, data_folder, joined, moved, refused
from scipy import sparse
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from studies.matching.subjects import subjects_in, truth_between

import spectra_kit as sk
from spectra_kit.geodesics import FacePoint
from spectra_kit.geometry import TriangleMesh, largest_component, torus
from spectra_kit.maps import Candidate, Carrier, Match
from spectra_kit.maps.convert import into_triangles

TURN = Rotation.from_rotvec([0.5, 1.0, 0.2])


def precise(source: TriangleMesh, target: TriangleMesh):
    """Where points of one mesh lie on another that it lies on."""
    closest = cKDTree(source.points).query(target.points)[1]
    return into_triangles(target.points, source.points, source.faces, closest)


def rings(n_source: int, n_target: int) -> tuple[TriangleMesh, TriangleMesh, Carrier]:
    """Two meshes of one ring, the second turned and larger."""
    source, still = (torus(n=n, minor=0.4).geometry for n in (n_source, n_target))
    target = still.with_points(2.5 * TURN.apply(still.points))
    return source, still, Carrier(source, target, precise(source, still))


def around_the_axis(points):
    return np.column_stack([-points[:, 1], points[:, 0], np.zeros(len(points))])


def halved(mesh: TriangleMesh) -> TriangleMesh:
    """The mesh with each face cut in four; those of face f are 4f to 4f + 3."""
    edges, inverse = np.unique(
        np.sort(np.stack([mesh.faces, np.roll(mesh.faces, -1, axis=1)], axis=2), axis=2).reshape(
            -1, 2
        ),
        axis=0,
        return_inverse=True,
    )
    middle = mesh.n + inverse.reshape(-1, 3)
    a, b, c = mesh.faces.T
    ab, bc, ca = middle.T
    four = np.stack([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]])
    points = np.vstack([mesh.points, mesh.points[edges].mean(axis=1)])
    return TriangleMesh(points, np.moveaxis(four, 2, 0).reshape(-1, 3))


def test_along_the_identity_nothing_changes():
    mesh = bumpy()
    rng, carrier = np.random.default_rng(0), Carrier(mesh, mesh, np.arange(mesh.n))
    values, labels = rng.standard_normal((mesh.n, 2, 3)), rng.integers(-4, 9, mesh.n)
    np.testing.assert_array_equal(carrier.values(values), values)
    np.testing.assert_array_equal(carrier.labels(labels).labels, labels)
    values, labels = values[:, 0].repeat(2, axis=0)[: len(mesh.faces)], np.arange(len(mesh.faces))
    np.testing.assert_array_equal(carrier.face_values(values), values)
    np.testing.assert_array_equal(carrier.face_labels(labels).labels, labels)
    places = [7, FacePoint(3, (0.2, 0.3, 0.5))]
    vertex, inside = carrier.landmarks(places)
    assert vertex == 7
    assert inside.face == 3
    np.testing.assert_allclose(inside.barycentric, (0.2, 0.3, 0.5), atol=1e-9)
    np.testing.assert_allclose(carrier.back.values(mesh.points), mesh.points, atol=1e-12)
    uv = mesh.points[:, :2]
    np.testing.assert_allclose(carrier.texture(uv, mesh.faces), uv[mesh.faces], atol=1e-12)
    bent = mesh.points + 0.2 * np.sin(mesh.points[:, [2, 0, 1]])
    np.testing.assert_allclose(carrier.deformation(bent), bent, atol=1e-9)


def test_along_the_identity_nothing_changes_of_uneven_parts_wound_inwards():
    """Needles beside large triangles: what is nearest lies in no triangle at the nearest corner."""
    mesh = creature(600)
    for _ in range(3):  # cut at their middles, again and again, in one place
        near = np.linalg.norm(mesh.points[mesh.faces].mean(axis=1) - mesh.points[7], axis=1) < 0.3
        a, b, c = mesh.faces[near].T
        d = mesh.n + np.arange(len(a))
        points = np.vstack([mesh.points, mesh.points[mesh.faces[near]].mean(axis=1)])
        cut = [np.stack(corners, axis=1) for corners in ((a, b, d), (b, c, d), (c, a, d))]
        mesh = TriangleMesh(points, np.vstack([mesh.faces[~near], *cut]))
    mesh = TriangleMesh(mesh.points, mesh.faces[:, ::-1])
    mesh = joined(mesh, moved(mesh, 0.5, 3.0, 0.0, scale=0.3))
    carrier, numbers = Carrier(mesh, mesh, np.arange(mesh.n)), np.arange(len(mesh.faces))
    np.testing.assert_array_equal(carrier.face_labels(numbers).labels, numbers)
    for face in numbers[::97].tolist():
        (there,) = carrier.landmarks(FacePoint(face, (0.7, 0.2, 0.1)))
        assert there.face == face
        np.testing.assert_allclose(there.barycentric, (0.7, 0.2, 0.1), atol=1e-9)
    half = mesh.points @ TURN.as_matrix() + [1, 2, 3]
    bent = np.where(mesh.component_labels[:, None] == 0, half, mesh.points)  # one of them moves
    np.testing.assert_allclose(carrier.deformation(bent), bent, atol=1e-9)


def test_labels_are_as_sure_as_what_is_around_agrees():
    mesh = bumpy()
    halves = (mesh.points[:, 2] > 0).astype(int)
    found = Carrier(mesh, mesh, np.arange(mesh.n)).labels(halves)
    edges = mesh.unique_edges[0]
    border = np.unique(edges[halves[edges[:, 0]] != halves[edges[:, 1]]])
    away = np.setdiff1d(np.arange(mesh.n), border)
    assert (found.confidence[away] == 1).all()
    assert (found.confidence[border] < 1).all()
    assert found.confidence.min() > 0


def test_parts_of_faces_have_what_the_whole_had():
    mesh = bumpy(162)
    fine = halved(mesh)
    carrier, labels = Carrier(mesh, fine, precise(mesh, fine)), np.arange(len(mesh.faces))
    np.testing.assert_array_equal(carrier.face_labels(labels).labels, labels.repeat(4))
    np.testing.assert_array_equal(carrier.face_values(labels), labels.repeat(4))
    assert carrier.face_labels(labels).confidence.min() >= 1 / 4  # itself and three others
    back = carrier.back.values(fine.points)
    np.testing.assert_allclose(back, mesh.points, atol=1e-12)


def test_vectors_turn_and_stretch_with_the_surface():
    worst = []
    for n in (2000, 8000):
        source, still, carrier = rings(n, 3 * n // 4)
        carried = carrier.vectors(around_the_axis(source.points))
        expected = 2.5 * TURN.apply(around_the_axis(still.points))
        apart = np.linalg.norm(carried - expected, axis=1) / np.linalg.norm(expected, axis=1)
        worst.append(np.quantile(apart, 0.99))
    assert worst[0] < 0.01
    assert worst[1] < worst[0] / 2


def test_vectors_know_no_unit_and_no_winding():
    source, still, _ = rings(1500, 1200)
    field, places = around_the_axis(source.points), precise(source, still)
    plain = Carrier(source, still, places).vectors(field)
    turned = TriangleMesh(still.points * 1e-3, still.faces[:, ::-1])
    np.testing.assert_allclose(
        Carrier(source, turned, places).vectors(field), plain * 1e-3, atol=1e-9
    )


def test_textures_do_not_cross_their_seams():
    """A ring unrolled: each coordinate jumps by one at its seam, in no face."""

    def unrolled(mesh):
        x, y, z = mesh.points.T
        angles = np.stack([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y) - 1)], axis=1)
        return angles / (2 * np.pi)

    source, still, carrier = rings(1500, 4000)
    corners = unrolled(source)[source.faces]
    corners -= np.round(corners - corners[:, :1])
    uv, named = np.unique(corners.reshape(-1, 2).round(12), axis=0, return_inverse=True)
    assert len(uv) > source.n
    found = carrier.texture(uv, named.reshape(-1, 3))
    apart = found - unrolled(still)[still.faces]
    assert abs(apart - np.round(apart)).max() < 0.02  # half of a triangle of the source
    assert np.ptp(found, axis=1).max() < 2 * np.ptp(corners, axis=1).max()
    assert (abs(np.round(apart)) > 0).any()  # both sides of the seams are there


def test_textures_keep_to_their_charts():
    """Six charts, by the side that faces look to, one upon the other: nothing changes."""
    mesh = bumpy()
    a, b, c = (mesh.points[corner] for corner in mesh.faces.T)
    normals = np.cross(b - a, c - a)
    axis = np.abs(normals).argmax(axis=1)
    side = 2 * axis + (normals[np.arange(len(axis)), axis] > 0)
    pairs = np.column_stack([side.repeat(3), mesh.faces.ravel()])
    (charts, points), named = np.unique(pairs.T, axis=1, return_inverse=True)
    plane = np.array([[1, 2], [0, 2], [0, 1]])[charts // 2]
    uv, named = np.take_along_axis(mesh.points[points], plane, axis=1), named.reshape(-1, 3)
    carrier = Carrier(mesh, mesh, np.arange(mesh.n))
    np.testing.assert_allclose(carrier.texture(uv, named), uv[named], atol=1e-12)
    soft = np.eye(mesh.n)  # each point mixed with those around it
    i, j = mesh.unique_edges[0].T
    soft[i, j] = soft[j, i] = 0.1
    mixed = Carrier(mesh, mesh, sparse.csr_array(soft / soft.sum(axis=1, keepdims=True)))
    assert abs(mixed.texture(uv, named) - uv[named]).max() < 0.25  # and no chart away


def test_an_affine_deformation_is_carried_as_it_is():
    source, still, carrier = rings(1500, 1200)
    linear = np.array([[1.0, 0.2, 0.0], [0.0, 1.5, -0.3], [0.1, 0.0, 0.8]])
    found = carrier.deformation(source.points @ linear.T + [3, 4, 5])
    moved = still.points @ linear.T
    expected = 2.5 * TURN.apply(moved)
    size = np.ptp(expected, axis=0).max()
    apart = found - found.mean(axis=0) - expected + expected.mean(axis=0)
    assert np.linalg.norm(apart, axis=1).max() < 0.02 * size
    shift = found.mean(axis=0) - carrier.target.points.mean(axis=0)
    np.testing.assert_allclose(shift, 2.5 * TURN.apply([3, 4, 5]), rtol=0.05)


def test_nothing_is_said_where_nothing_corresponds():
    mesh = creature(1000)
    covered = mesh.points[:, 0] < 0.3
    match = Match(
        point_map=np.arange(mesh.n),
        functional_map=np.eye(30),
        mirrored=False,
        orientation=1.0,
        margin=2.0,
        mirror_margin=2.0,
        consistent=1.0,
        coverage=1.5,
        discontinuity=0.0,
        candidates=(
            Candidate(functional_map=np.eye(30), score=0.1, mismatches={}, mirrored=False),
        ),
        covered=covered,
    )
    carrier, x = Carrier(mesh, mesh, match), mesh.points[:, 0]
    tails = x < -0.3
    for carried in (carrier.values(x), match.carry(x)):
        np.testing.assert_array_equal(np.isnan(carried), ~covered)
    vectors = carrier.vectors(mesh.points)
    assert np.isnan(vectors[~covered]).all()
    assert np.isnan(vectors[covered]).mean() < 0.02  # where what was filled in crushes the border
    np.testing.assert_array_equal(match.carry(x)[covered], x[covered])
    for labels in (carrier.labels(np.ones(mesh.n, int)).labels, match.carry(np.ones(mesh.n, int))):
        np.testing.assert_array_equal(labels, np.where(covered, 1, -1))
    kept = covered[mesh.faces].all(axis=1)
    ones = np.ones(len(mesh.faces), int)
    np.testing.assert_array_equal(carrier.face_labels(ones).labels, np.where(kept, 1, -1))
    np.testing.assert_array_equal(np.isnan(carrier.face_values(ones * 1.0)), ~kept)
    uv = carrier.texture(mesh.points[:, :2], mesh.faces)
    np.testing.assert_array_equal(np.isnan(uv).any(axis=(1, 2)), ~kept)
    stretched = carrier.deformation(mesh.points * [2, 1, 1])
    np.testing.assert_allclose(stretched[tails], (mesh.points * [2, 1, 1])[tails], atol=0.02)
    nose, tail = int(np.argmax(x)), int(np.argmin(x))
    assert carrier.landmarks([nose, tail]) == [None, tail]
    assert not carrier.back.known[nose]
    assert carrier.back.known[covered].all()


def test_two_parts_meet_on_a_whole():
    """What is known of the second is what the first has as well, at the same places."""
    whole = bumpy()
    x = whole.points[:, 0]

    def part(kept):
        cut = largest_component(TriangleMesh(whole.points, whole.faces[kept[whole.faces].all(1)]))
        ones, own = np.ones(cut.mesh.n), np.arange(cut.mesh.n)
        onto = sparse.csr_array((ones, (cut.vertex_index, own)), shape=(whole.n, cut.mesh.n))
        return cut, Carrier(cut.mesh, whole, onto)

    (left, one), (right, other), (_, third) = (part(kept) for kept in (x < 0.3, x > -0.3, x > 0.5))
    through = one.then(other.back)
    np.testing.assert_array_equal(through.known, np.isin(right.vertex_index, left.vertex_index))
    assert 0.2 < through.known.mean() < 0.8
    carried = through.values(left.mesh.points)
    np.testing.assert_allclose(carried[through.known], right.mesh.points[through.known], atol=1e-12)
    assert (through.source, through.target) == (left.mesh, right.mesh)
    refused("other", "reach what this reaches", one.then, third.back)
    refused("other", f"begin at the target of this, {whole.n} points", one.then, other)


def test_clouds_carry_what_points_have():
    source, still, _ = rings(1500, 1200)
    for one, other in ((source.as_cloud(), still), (source, still.as_cloud())):
        carrier = Carrier(one, other, precise(source, still))
        field = around_the_axis(source.points)
        carried = carrier.vectors(field)
        assert abs(carried - around_the_axis(still.points)).max() < 0.05
        assert carrier.labels(np.arange(source.n) % 3).labels.shape == (still.n,)
        assert carrier.back.values(still.points).shape == source.points.shape
    (there,) = carrier.landmarks(5)
    assert isinstance(there, int)
    assert np.linalg.norm(still.points[there] - source.points[5]) < 0.1
    refused("target", "be a mesh, where textures", carrier.texture, np.zeros((3, 2)), source.faces)


def test_a_match_carries_what_its_map_does():
    source, target, truth = sk.geometry.creature_pair(700, 600, seed=1)
    match = sk.match(
        sk.prepare(sk.spectrum(source, 60), source),
        sk.prepare(sk.spectrum(target, 60), target),
        precise=True,
    )
    np.testing.assert_array_equal(match.carry(source.points), match.precise @ source.points)
    legs = (source.points[:, 2] < 0).astype(int)
    assert (match.carry(legs) == legs[truth]).mean() > 0.95
    assert match.carry(legs).dtype.kind == "i"
    of_faces = np.zeros(len(source.faces), int)
    for found in (match, replace(match, precise=None)):
        refused("values", "be integers of shape (700,)", found.carry, of_faces)


def test_they_refuse():
    mesh = bumpy(162)
    carrier = Carrier(mesh, mesh, np.arange(mesh.n))
    refused("along", "have shape (162,)", Carrier, mesh, mesh, [0, 1])
    refused("along", "have rows of weights", Carrier, mesh, mesh, 0.5 * precise(mesh, mesh))
    refused("along", "lead somewhere", Carrier, mesh, mesh, 0.0 * precise(mesh, mesh))
    refused("values", "have shape (162, ...)", carrier.values, [1.0, 2.0])
    refused("values", f"have shape ({len(mesh.faces)}, ...)", carrier.face_values, np.ones(162))
    refused("labels", "be integers of shape (162,)", carrier.labels, np.ones(162))
    refused("labels", "fit into 64 bits", carrier.labels, np.full(162, 2**63, np.uint64))
    refused("vectors", "have shape (162, 3)", carrier.vectors, np.ones(162))
    refused("coordinates", "have shape (t, 2)", carrier.texture, mesh.points, mesh.faces)
    refused("points", "have shape (162, ...)", carrier.deformation, mesh.points[:9])


@pytest.mark.data
def test_labels_carried_over_bodies():
    """Twelve regions of a body, on two others: as the truth has them but at their borders."""
    root = data_folder()
    if root is None or not (root / "faust_r").is_dir():
        pytest.skip("set SPECTRA_KIT_DATA to the folder of real shapes to run this")
    subjects = subjects_in(root / "faust_r")
    one, *others = (subjects[f"tr_reg_{i:03d}"] for i in (3, 17, 52))
    mesh = one.mesh
    seeds = sk.geodesics.farthest_point_sampling(mesh, 12)
    regions = np.argmin([sk.geodesics.exact_distances(mesh, int(s)) for s in seeds], axis=0)
    for other in others:
        match = sk.match(sk.prepare(mesh), sk.prepare(other.mesh), precise=True)
        found, truth = Carrier(mesh, other.mesh, match).labels(regions), truth_between(one, other)
        true, carried = regions[truth.source], found.labels[truth.target]
        shares = [
            ((true == r) & (carried == r)).sum() / ((true == r) | (carried == r)).sum()
            for r in range(12)
        ]
        assert np.mean(shares) > 0.85
        sure = found.confidence[truth.target]
        assert sure[true == carried].mean() > sure[true != carried].mean() + 0.1
