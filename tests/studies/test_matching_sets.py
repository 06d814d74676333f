"""Sets by name, and one body in six triangulations."""

import numpy as np
import pytest
from conftest import bumpy, creature
from scipy.spatial import cKDTree
from studies.matching.sets import (
    USUAL,
    PairSet,
    Protocol,
    make_protocol,
    pair_sets,
    remade_sets,
)
from studies.matching.spoilings import SPOILINGS, holes
from studies.matching.subjects import LACKING, Subject, demo_subjects, truth_between
from studies.matching.triangulations import TRIANGULATIONS, finer, remade, rounding
from studies.shapes import mean_edge

import spectra_kit as sk
from spectra_kit import TriangleMesh
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import PointCloud, components, torus

# --- sets by name ---


@pytest.fixture
def data(tmp_path, monkeypatch):
    """A folder of data with the sets whose protocols are known, and another."""
    mesh = bumpy()
    for name in (*(name for name in USUAL if USUAL[name] != "given"), "own"):
        (tmp_path / name).mkdir()
        for subject in ("cat0", "cat1", "dog-2_x"):
            np.savez(tmp_path / name / f"{subject}.npz", V=mesh.points, F=mesh.faces, corres=[0, 1])
    monkeypatch.setenv("SPECTRA_KIT_DATA", str(tmp_path))
    return tmp_path


def test_every_set_has_its_usual_pairs(data, monkeypatch):
    usual = {name: protocol for name, protocol in USUAL.items() if protocol != "given"}
    found = {one.name: one for one in pair_sets([*usual, data / "own"])}
    assert {name: one.protocol.name for name, one in found.items()} == {**usual, "own": "random"}
    assert len(found["smal_r"].protocol.pairs) == 6
    assert found["tosca_r"].protocol.pairs == (("cat0", "cat1"), ("cat1", "cat0"))
    assert list(found["tosca_r"].subjects) == ["cat0", "cat1"]  # no other is read again
    [few] = pair_sets(["smal_r"], protocol="random", count=2, seed=1)
    drawn = make_protocol("random", found["smal_r"].subjects.values(), count=2, seed=1)
    assert few.protocol == drawn
    [cats] = pair_sets(["smal_r"], only=["cat"])
    assert set(cats.subjects) == {"cat0", "cat1"}
    with pytest.raises(InvalidInputError, match="another one for smal_r, whose names tell no"):
        pair_sets(["smal_r"], protocol="same-class")
    monkeypatch.delenv("SPECTRA_KIT_DATA")
    with pytest.raises(InvalidInputError, match="names of sets in SPECTRA_KIT_DATA"):
        pair_sets(["smal_r"])


def test_scans_come_with_the_truth_of_each_pair(tmp_path):
    """And as they are: vertices twice, a face turned, a speck beside the body."""
    body, folder = creature(500, pose=1), tmp_path / "shrec19"
    folder.mkdir()
    other = creature(500, pose=2)
    speck = np.array([[9.0, 9, 9], [9, 9.1, 9], [9.1, 9, 9]])
    turned = other.faces.copy()
    turned[7] = turned[7, ::-1]
    points = np.concatenate([speck, other.points])
    faces = np.concatenate([[[0, 1, 2]], turned + 3])
    np.savez(folder / "01.npz", V=body.points, F=body.faces, evaluated=np.arange(0, 500, 5))
    np.savez(folder / "02.npz", V=points, F=faces, evaluated=np.arange(500))
    there = np.arange(3, 503)  # the vertex of 02 that is that of 01
    there[10] = 1  # in the speck
    np.savez(folder / "pairs.npz", **{"01_02": there})
    [found] = pair_sets([folder])
    assert found.protocol == Protocol("given", (("02", "01"),))
    source, target = (found.subjects[name] for name in ("02", "01"))
    assert source.mesh.n == other.n
    wound = [[np.roll(f, -f.argmin()).tolist() for f in m.faces] for m in (source.mesh, other)]
    assert wound[0] == wound[1]
    truth = truth_between(source, target)
    assert len(truth.target) == 99
    gaps = source.mesh.points[truth.source] - other.points[truth.target]
    assert np.abs(gaps).max() < 1e-12


# --- six triangulations ---


@pytest.fixture(scope="module")
def animal():
    mesh = creature(1500)
    return Subject(
        "animal", mesh, np.arange(0, mesh.n, 3), np.arange(1, mesh.n, 3)[: -(-mesh.n // 3)]
    )


@pytest.fixture(scope="module")
def made(animal):
    return {kind: remade(animal, kind, TRIANGULATIONS, seed=3) for kind in TRIANGULATIONS}


def test_they_are_one_surface_with_its_landmarks(animal, made):
    edge = np.sqrt(animal.mesh.area / animal.mesh.n)
    for kind, subject in made.items():
        there = subject.landmarks != LACKING
        assert there.mean() > 0.9, kind
        apart = np.linalg.norm(
            animal.geometry.points[animal.landmarks[there]]
            - subject.geometry.points[subject.landmarks[there]],
            axis=1,
        )
        assert apart.mean() < edge, kind
        assert rounding(animal, subject) == pytest.approx(
            100 * apart.mean() / np.sqrt(animal.mesh.area)
        )
        if kind != "cloud":
            assert len(components(subject.mesh)) == 1
            assert subject.mesh.area == pytest.approx(animal.mesh.area, rel=0.06)
    assert rounding(animal, made["isotropic"]) == 0


def test_landmarks_of_what_is_cut_off_are_lost(animal, monkeypatch):
    low = animal.mesh.points[:, 2].min() + 0.3 * np.ptp(animal.mesh.points[:, 2])

    def cut(mesh, rng):
        kept = mesh.faces[(mesh.points[mesh.faces][:, :, 2] > low).all(axis=1)]
        return TriangleMesh(mesh.points, kept).without_unreferenced()

    monkeypatch.setitem(TRIANGULATIONS, "cut", cut)
    made = remade(animal, "cut", TRIANGULATIONS)
    far = animal.mesh.points[animal.landmarks, 2] < low - np.sqrt(animal.mesh.area / animal.mesh.n)
    assert far.any()
    assert (made.landmarks[far] == LACKING).all()
    truth = truth_between(animal, made)
    both = made.landmarks != LACKING
    np.testing.assert_array_equal(truth.source, animal.landmarks[both])
    np.testing.assert_array_equal(truth.symmetric, animal.mirrored[both])
    back = truth_between(made, animal)  # where the mirror image is lost, the landmark is, too
    assert len(back.source) == (both & (made.mirrored != LACKING)).sum()
    assert (back.symmetric >= 0).all()


def slenderness(mesh):
    """Longest side over the height upon it, of the triangles: 1.15 if they are equilateral."""
    a, b, c = mesh.points[mesh.faces].transpose(1, 0, 2)
    longest = np.max([((p - q) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    return longest / (2 * mesh.face_areas)


def test_each_is_what_it_says(animal, made):
    n = animal.mesh.n
    assert made["isotropic"].mesh is animal.mesh
    assert np.percentile(slenderness(made["marching cubes"].mesh), 99) > 20  # slivers
    areas = made["quadric"].mesh.face_areas  # large ones where it is flat
    assert np.ptp(np.log(np.percentile(areas, (5, 95)))) > np.ptp(
        np.log(np.percentile(animal.mesh.face_areas, (5, 95)))
    )
    for kind in ("anisotropic", "quadric"):
        assert made[kind].mesh.n == pytest.approx(n, abs=2)
    assert len(made["dense"].mesh.faces) == 4 * len(animal.mesh.faces)
    assert isinstance(made["cloud"].geometry, PointCloud)
    assert made["cloud"].geometry.n == n


def along_over_across(mesh):
    """Mean length of edges along the ring of a torus over that across."""
    a, b = mesh.points[mesh.unique_edges[0]].transpose(1, 0, 2)
    ring = np.cross([0.0, 0.0, 1.0], (a + b) / 2)
    along = ((b - a) * ring / np.linalg.norm(ring, axis=1, keepdims=True)).sum(axis=1)
    across = np.sqrt(np.maximum(((b - a) ** 2).sum(axis=1) - along**2, 0))
    return np.abs(along).mean() / across.mean()


def test_anisotropic_triangles_are_long_where_a_tube_is_straight():
    minor = 0.2
    tube = torus(n=2000, major=1.0, minor=minor).geometry
    turn = 0.1 * np.sqrt(tube.area)  # the metric of positions and normals is 1 + (turn k)^2
    expected = np.sqrt((1 + (turn / minor) ** 2) / (1 + turn**2))
    made = TRIANGULATIONS["anisotropic"](tube, np.random.default_rng(0))
    assert expected > 1.6
    assert along_over_across(made) == pytest.approx(expected, rel=0.1)


def test_finer_is_the_same_surface_with_its_vertices(animal):
    made = finer(animal.mesh, 10_000)
    assert 10_000 <= made.n < 20_000
    np.testing.assert_allclose(made.points[: animal.mesh.n], animal.mesh.points, rtol=1e-6)
    assert made.area == pytest.approx(animal.mesh.area, rel=1e-6)
    edges, uses = np.unique(
        np.sort(made.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)), axis=0, return_counts=True
    )
    assert (uses == 2).all()
    assert made.n - len(edges) + len(made.faces) == 2  # a sphere, as the animal is


def ring(name):
    """A torus so thin that marching cubes of its size fill the hole."""
    mesh = torus(n=200, major=1.0, minor=0.98).geometry
    assert isinstance(mesh, TriangleMesh)
    return Subject(name, mesh, [0])


def test_pairs_come_in_all_triangulations(animal):
    subjects = {**demo_subjects(600, poses=2), "ring": ring("ring")}
    pairs = (("creature0", "ring"), ("creature0", "creature1"), ("creature1", "creature0"))
    zoo = PairSet("zoo", subjects, Protocol("random", pairs))
    sets = remade_sets(zoo, TRIANGULATIONS, count=1)
    assert [one.name for one in sets] == [
        f"zoo-{kind.replace(' ', '_')}" for kind in TRIANGULATIONS
    ]
    assert {one.against for one in sets} == {"zoo-isotropic"}
    for one in sets:
        [(source, target)] = one.protocol.pairs  # the ring is passed over
        assert source == "creature0"
        assert target == one.name.replace("zoo", "creature1")
        assert set(one.subjects) == {source, target}
        assert one.note.endswith("as they cannot be made so: ring")
    assert "0.00 away" in sets[0].note


def test_a_surface_that_grows_together_is_refused():
    with pytest.raises(InvalidInputError, match="`mesh` must keep its topology in marching cubes"):
        remade(ring("ring"), "marching cubes", TRIANGULATIONS)
    rings = PairSet("rings", {"a": ring("a")}, Protocol("random", (("b", "a"),)))
    with pytest.raises(InvalidInputError, match="hold a target of which all can be made"):
        remade_sets(rings, TRIANGULATIONS, count=1)


# --- spoiled ---


def euler(mesh):
    return mesh.n - len(mesh.unique_edges[0]) + len(mesh.faces)


def test_what_touches_grows_together():
    """A bar that is bent to a ring whose ends nearly meet becomes a ring."""
    n, around = 120, 24
    turn = np.linspace(0.03, 2 * np.pi - 0.03, n)[:, None]
    about = np.linspace(0, 2 * np.pi, around, endpoint=False)[None]
    far = 1 + 0.25 * np.cos(about)
    side = np.stack([far * np.cos(turn), far * np.sin(turn), 0.25 * np.sin(about) + 0 * turn], -1)
    ends = np.stack([[np.cos(t), np.sin(t), 0.0] for t in turn[[0, -1], 0]])
    i, j = np.meshgrid(np.arange(n - 1), np.arange(around), indexing="ij")
    a, b = i * around + j, i * around + (j + 1) % around
    sides = np.concatenate(
        [np.stack(t, -1).reshape(-1, 3) for t in ((a, a + around, b), (b, a + around, b + around))]
    )
    rim, last = np.arange(around), (n - 1) * around
    caps = [[p, (p + 1) % around, n * around] for p in rim]
    caps += [[last + (p + 1) % around, last + p, n * around + 1] for p in rim]
    bar = TriangleMesh(np.vstack([side.reshape(-1, 3), ends]), np.vstack([sides, caps]))
    assert euler(bar) == 2
    made = SPOILINGS["merged"](bar, np.random.default_rng(0))
    assert euler(made) == 0
    assert len(components(made)) == 1
    assert made.area == pytest.approx(bar.area, rel=0.05)
    with pytest.raises(InvalidInputError, match="have parts that touch"):
        SPOILINGS["merged"](sk.geometry.sphere(subdivisions=3).geometry, np.random.default_rng(0))


def test_each_spoiling_is_what_it_says(animal):
    mesh, edge = animal.mesh, mean_edge(animal.mesh)
    made = {kind: remade(animal, kind, SPOILINGS, seed=1) for kind in SPOILINGS if kind != "merged"}
    assert made["clean"].mesh is mesh
    for share in (5, 15, 30):
        left = made[f"holes {share} %"].mesh
        assert left.area < (1 - 0.005 * share) * mesh.area  # what they leave may fall off too
        assert len(components(left)) == 1
        assert len(left.boundary_vertices)
    assert made["ragged rims"].mesh.area > 0.85 * mesh.area
    smooth = holes(mesh, np.random.default_rng(1), share=0.02)
    assert len(made["ragged rims"].mesh.boundary_vertices) > len(smooth.boundary_vertices)
    assert made["cut 30 %"].mesh.area < 0.75 * mesh.area
    moved = made["noise"].mesh.points - mesh.points
    assert np.sqrt((moved**2).sum(axis=1).mean()) == pytest.approx(0.5 * edge, rel=0.05)
    areas = made["uneven"].mesh.face_areas
    assert np.percentile(areas, 90) > 2.5 * np.percentile(areas, 25)
    assert made["uneven"].mesh.n == pytest.approx(mesh.n, abs=3)
    faces = made["turned faces"].mesh.faces
    assert (faces != mesh.faces).any(axis=1).sum() == len(faces) // 100
    seen = {views: made[f"scan, {views} views"] for views in (2, 4)}
    for scan in seen.values():
        fine = finer(mesh, 20 * mesh.n).points
        apart, _ = cKDTree(fine).query(scan.geometry.points)
        assert 0.05 * edge < apart.mean() < edge  # near the surface, and not on it
    lost = {views: (scan.landmarks == LACKING).mean() for views, scan in seen.items()}
    assert lost[2] > lost[4]
