"""The command that matches two shapes."""

import csv
import json
import os
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import bumpy, creature
from running import printed, record, refusal
from scipy import sparse
from scipy.spatial.transform import Rotation

from spectra_kit.cli import main
from spectra_kit.cli.match_result import doubts_of
from spectra_kit.geometry import (
    TriangleMesh,
    creature_pair,
    largest_component,
    mirrored,
    permuted,
    read,
    sphere,
    torus,
    write,
)

DRAWN = ("correspondence.png",)
KEYS = ("target", "points", "first", "source", "source_points", "source_first")
FILES = {"point_map.npy", "functional_map.npy", "report.json"}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """An animal, the same one renumbered, one bent, and the truth of both."""
    folder = tmp_path_factory.mktemp("shapes")
    mesh = creature(600)
    copy, order = permuted(mesh, seed=1)
    write(mesh, folder / "animal.off")
    write(mesh.as_cloud(), folder / "cloud.ply")
    write(mirrored(copy), folder / "mirrored.off")
    write(copy, folder / "permuted.off")
    np.save(folder / "order.npy", order)
    source, target, truth = creature_pair(700, 600)
    write(source, folder / "source.off")
    write(target, folder / "target.off")
    np.save(folder / "truth.npy", truth)
    chosen = np.linspace(0, target.n - 1, 12).astype(int)
    np.savetxt(folder / "landmarks.txt", np.column_stack([truth[chosen], chosen]), fmt="%d")
    return folder


def report(capsys, *arguments):
    """Match in silence; return the report."""
    return record(capsys, "match", *arguments, "--no-pictures")


def refused(capsys, *arguments):
    return refusal(capsys, "match", *arguments, "--no-pictures")


@pytest.mark.parametrize("copy", ["permuted.off", "mirrored.off"])
def test_a_copy_gives_the_permutation(files, tmp_path, capsys, copy):
    pair = (files / "animal.off", files / copy, "--truth", files / "order.npy")
    result = report(capsys, *pair, "-k", 60, "-o", tmp_path / "out")
    found, sign = result["match"], -1 if copy == "mirrored.off" else 1
    np.testing.assert_array_equal(
        np.load(tmp_path / "out" / "point_map.npy"), np.load(files / "order.npy")
    )
    assert set(os.listdir(tmp_path / "out")) == FILES
    assert np.load(tmp_path / "out" / "functional_map.npy").shape == (60, 60)
    assert found["mean_error"] == found["median_error"] == found["inverse_error"] == 0
    assert found["coverage"] == found["auc_to_10"] == found["share_of_errors_below_5"] == 1
    assert found["point_map_orientation"] == pytest.approx(sign, rel=1e-3)
    assert sign * found["orientation"] > 0.99
    assert found["convincing"]
    assert found["dirichlet_energy"] == pytest.approx(1, rel=1e-3)
    assert found["mirrored"] is (sign < 0)
    assert found["ambiguous"] is False
    assert found["other_side"] > 1
    assert "doubts" not in found
    assert result["target"]["points"] == 600
    saved = json.loads((tmp_path / "out" / "report.json").read_text())
    assert saved == {key: value for key, value in result.items() if key != "written"}


def test_a_bent_and_remeshed_copy_by_landmarks(files, tmp_path, capsys):
    result = report(
        capsys,
        *(files / "source.off", files / "target.off", "-k", 60, "-o", tmp_path / "out"),
        *("--truth", files / "truth.npy", "--landmarks", files / "landmarks.txt"),
    )
    assert result["landmarks"] == 12
    assert 0 < result["match"]["mean_error"] < 5
    assert result["match"]["orientation"] > 0.5


@pytest.mark.parametrize("known", [("--aligned",), ("--initial", "order.npy")])
def test_what_is_aligned_is_refined(files, tmp_path, capsys, known):
    """A renumbered copy: nothing is searched for, and the order is found."""
    option, *name = known
    given = (option, *(files / one for one in name))
    pair = (files / "animal.off", files / "permuted.off", "-k", 40, "-o", tmp_path / "out")
    result = report(capsys, *pair, *given)
    assert result["match"]["candidates"] == 1
    assert (np.load(tmp_path / "out" / "point_map.npy") == np.load(files / "order.npy")).all()


def test_a_speck_and_seams_leave_no_shape_out_and_maps_number_the_files(files, tmp_path, capsys):
    """The target has a speck before it; faces of the source have corners of their own."""
    animal = read(files / "animal.off")
    speck = sphere(subdivisions=0).geometry
    points = np.vstack([0.01 * speck.points + [3, 0, 0], animal.points])
    write(TriangleMesh(points, np.vstack([speck.faces, animal.faces + 12])), tmp_path / "scan.off")
    corners = animal.points[animal.faces].reshape(-1, 3)
    flat = TriangleMesh(corners, np.arange(len(corners)).reshape(-1, 3))
    write(flat, tmp_path / "flat.ply")
    pair, out = (tmp_path / "flat.ply", tmp_path / "scan.off"), tmp_path / "out"
    told = refused(capsys, files / "animal.off", pair[1], "-k", 40, "-o", out)
    assert "by --largest, or each with its own, by match --components" in told
    at = np.full(animal.n, -1)  # the first corner at each vertex
    at[animal.faces.ravel()[::-1]] = np.arange(len(corners))[::-1]
    truth = np.concatenate([np.full(12, -1), at])
    np.save(tmp_path / "truth.npy", truth)
    np.savetxt(tmp_path / "pairs.txt", np.c_[at, np.arange(animal.n) + 12][::40], fmt="%d")
    command = (*pair, "-k", 60, "--repair", "--largest", "--precise", "-o", out)
    known = ("--truth", tmp_path / "truth.npy", "--landmarks", tmp_path / "pairs.txt")
    told, err = printed(capsys, "match", *command, *known, "--no-pictures", "--json")
    assert "the largest part: 600 points; 12 left out" in err
    assert json.loads(told)["match"]["mean_error"] == 0
    np.testing.assert_array_equal(np.load(out / "point_map.npy"), truth)
    precise = sparse.load_npz(out / "precise_map.npz")
    assert precise.shape == (len(points), len(corners))
    np.testing.assert_allclose(precise @ corners, np.vstack([np.zeros((12, 3)), animal.points]))
    assert set(os.listdir(out)) == FILES | {"precise_map.npz"}
    (tmp_path / "pairs.txt").write_text("0 3\n")  # on the speck
    assert main([*map(str, ("match", *command, *known))]) == 2
    told = capsys.readouterr().err
    assert "`--landmarks` must name points that are matched, got (0, 3)" in told


def test_clouds_are_matched_and_judged_as_far_as_they_can_be(files, tmp_path, capsys):
    pair = (files / "cloud.ply", files / "cloud.ply")
    result = report(capsys, *pair, "-k", 40, "-o", tmp_path / "out")
    assert result["source"]["kind"] == "cloud"
    assert result["match"]["coverage"] == 1
    assert result["match"]["inverse_error"] is None


def test_points_inside_triangles_are_written_as_a_sparse_matrix(files, tmp_path, capsys):
    pair, out = (files / "source.off", files / "target.off"), tmp_path / "out"
    made = report(capsys, *pair, "-k", 40, "--precise", "-o", out)
    assert str(out / "precise_map.npz") in made["written"]
    precise = sparse.load_npz(out / "precise_map.npz")
    np.testing.assert_allclose(precise.sum(axis=1), 1)
    corners = read(pair[0]).faces[:, :, None] == precise.indices[: precise.indptr[1]]
    assert corners.any(axis=1).all(axis=1).any()  # those of the first point are of one triangle
    few = ("-k", 40, "-o", out)
    assert "got precise_map.npz, which would stay" in refused(capsys, *pair, *few)


def test_a_part_that_lacks_nothing_covers_all(files, tmp_path, capsys):
    pair, out = (files / "animal.off", files / "permuted.off"), tmp_path / "out"
    found = report(capsys, *pair, "-k", 40, "--part", "--sides", "kept", "-o", out)["match"]
    assert set(os.listdir(out)) == FILES | {"covered.npy"}
    assert np.load(out / "covered.npy").all()
    np.testing.assert_array_equal(np.load(out / "point_map.npy"), np.load(files / "order.npy"))
    assert (found["covered_points"], found["covered_area"]) == (600, 1)
    assert found["confidence"] is found["dirichlet_energy"] is found["inverse_error"] is None


@pytest.mark.slow
def test_what_the_part_lacks_is_not_covered(tmp_path, capsys):
    whole, out = bumpy(), tmp_path / "out"
    left = whole.points[:, 2] < 0.5 * whole.points[:, 2].max()
    part = largest_component(TriangleMesh(whole.points, whole.faces[left[whole.faces].all(axis=1)]))
    write(part.mesh, tmp_path / "part.off")
    write(whole, tmp_path / "whole.off")
    pair = (tmp_path / "part.off", tmp_path / "whole.off", "--part", "--sides", "kept")
    text, _ = printed(capsys, "match", *pair, "-k", 30, "-o", out, "--dpi", 30)
    assert f"the map: the point of {pair[0]} that each covered point of {pair[1]} is" in text
    covered, kept = np.load(out / "covered.npy"), np.isin(np.arange(whole.n), part.vertex_index)
    assert (covered == kept).mean() > 0.95
    found = json.loads((out / "report.json").read_text())["match"]
    assert found["covered_points"] == covered.sum()
    assert found["covered_area"] == pytest.approx(part.mesh.area / whole.area, rel=0.1)
    assert found["coverage"] > 0.9
    assert found["point_map_orientation"] > 0.9
    assert (out / "correspondence.png").is_file()


def test_the_demo_draws_its_pictures(tmp_path, capsys):
    folder = tmp_path / "demo"
    command = ("match", "demo", "demo", "--points", 500, "-k", 30, "--dpi", 30, "-o", folder)
    out, _ = printed(capsys, *command)
    assert "dirichlet energy" in out
    assert "the map: the point of demo that each point of demo is" in out
    assert "mean error" in out
    pictures = ["correspondence.png", "functional_map.png", "errors.png"]
    assert set(os.listdir(folder)) == FILES | {*pictures} | {"source.npz", "target.npz"}
    for name in os.listdir(folder):
        assert f"written: {folder / name}" in out


def beside(*meshes):
    """One surface of these parts, each three further along x."""
    first = np.cumsum([0, *(mesh.n for mesh in meshes)])
    points = [mesh.points + [3.0 * i, 0, 0] for i, mesh in enumerate(meshes)]
    faces = [mesh.faces + n for mesh, n in zip(meshes, first, strict=False)]
    return TriangleMesh(np.vstack(points), np.vstack(faces))


def test_parts_are_matched_each_with_its_own_and_values_carried(tmp_path, capsys):
    """Two animals and a ring; copies of both, a speck between them, and a seam at one vertex."""
    one, other = creature(500, pose=1, seed=1), creature(600, pose=0, seed=4)
    ring = torus(n=500, major=1.0, minor=0.4).geometry
    (copy, truth), (twin, also) = permuted(one, seed=2), permuted(other, seed=3)
    source, speck = beside(one, ring, other), sphere(subdivisions=0).geometry
    target = beside(twin, speck, copy)
    last, faces = target.faces[-1, 0], target.faces.copy()
    faces[-1, 0] = target.n  # of the last face alone
    target = TriangleMesh(np.vstack([target.points, target.points[last]]), faces)
    pair, out = (tmp_path / "a.off", tmp_path / "b.off"), tmp_path / "out"
    write(source, pair[0])
    write(target, pair[1])
    options = ("--components", "--repair", "--sides", "kept", "-k", 60, "--dpi", 30)
    text, err = printed(capsys, "match", *pair, *options, "-o", out)
    assert err == "repaired: nothing to do\nrepaired: 1 merged point\n"
    assert f"the parts: that of {pair[0]} that each of {pair[1]} is" in text
    assert set(os.listdir(out)) == {"point_map.npy", "components.csv", "report.json", *DRAWN}
    first = one.n + ring.n
    known = np.concatenate([first + also, np.full(speck.n, -1), truth])
    known = np.append(known, known[last])
    np.testing.assert_array_equal(np.load(out / "point_map.npy"), known)
    found = json.loads((out / "report.json").read_text())["match"]
    assert (found["parts_with_a_partner"], found["covered_points"]) == (2, 1100)
    expected = [
        (0, 600, 0, 2, 600, first),
        (1, 12, 600, None, None, None),
        (2, 500, 612, 0, 500, 0),
    ]
    assert [tuple(part[key] for key in KEYS) for part in found["parts"]] == expected
    assert [part["confidence"] > 0.5 for part in found["parts"]] == [True, False, True]
    with (out / "components.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    for row, part in zip(rows, found["parts"], strict=True):
        assert row == {key: "" if it is None else str(it) for key, it in part.items()}
    np.save(tmp_path / "places.npy", source.points)
    values = (*pair, tmp_path / "places.npy", "--maps", out, "-o", tmp_path / "there.npy")
    assert record(capsys, "carry", *values)["undefined"] == speck.n
    carried = np.where(known[:, None] < 0, np.nan, source.points[known])
    np.testing.assert_array_equal(np.load(tmp_path / "there.npy"), carried)
    told = refused(capsys, *pair, "--largest", "-k", 60, "-o", out)
    assert "got components.csv" in told


@pytest.mark.filterwarnings("default::spectra_kit.errors.DoubtfulMatchWarning")
def test_a_part_that_nothing_convinces_of_says_why(files, tmp_path, capsys):
    write(torus(n=500, major=1.0, minor=0.4).geometry, tmp_path / "ring.off")
    pair = (files / "animal.off", tmp_path / "ring.off", "--components", "-k", 60)
    text, err = printed(
        capsys, "match", *pair, "--no-pictures", "--json", "-o", tmp_path / "out", "-q"
    )
    assert err.startswith("warning: part 0 of the source and part 0 of the target: no convincing")
    (part,) = json.loads(text)["match"]["parts"]
    assert part["source"] is None
    assert part["confidence"] < 0.5
    assert "have other numbers of handles" in part["doubts"]
    assert (np.load(tmp_path / "out" / "point_map.npy") == -1).all()


@pytest.mark.parametrize(
    ("doubts", "why"),
    [
        ((), ""),
        (("margin", "mirror_margin"), "scores as well, one that mirrors scores better"),
        (("orientation", "consistent"), "whole map, it is in doubt which side of a cloud is out"),
        (("coverage", "score"), "than chance would, the surfaces look no more alike than"),
        (("alike", "genera"), "others look as good, the surfaces have other numbers of handles"),
        (("rims", "landmark_distances"), "where the other is, it does not lead to all landmarks"),
        (("initial", "unconnected"), "no other was tried, no convincing pairs of the collection"),
    ],
)
def test_every_doubt_is_told(doubts, why):
    assert why in doubts_of(SimpleNamespace(mirrored=False, doubts=doubts))
    turned = doubts_of(SimpleNamespace(mirrored=True, doubts=doubts))
    assert ("does not mirror" in turned) == ("mirror_margin" in doubts)


@pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulMatchWarning")
def test_an_ambiguous_match_says_why(tmp_path, capsys):
    ball = sphere(subdivisions=2).geometry
    turn = Rotation.from_rotvec([0.3, 0.5, 0.7]).as_matrix()
    eggs = [tmp_path / "one.off", tmp_path / "other.off"]
    for path, points in zip(eggs, (ball.points, ball.points @ turn), strict=True):
        write(ball.with_points(points * [1.0, 1.0, 1.7]), path)
    result = report(capsys, *eggs, "-k", 30, "--sides", "kept", "-o", tmp_path / "out")
    assert result["match"]["ambiguous"] is True
    assert "another map scores as well" in result["match"]["doubts"]
    assert "so round that others look as good" in result["match"]["doubts"]
    assert result["match"]["convincing"] is False
    assert result["match"]["other_side"] is None  # not tried


def test_files_of_another_match_are_not_mixed_with_its_own(files, tmp_path, capsys):
    pair, out = (files / "animal.off", files / "permuted.off"), tmp_path / "out"
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    (out / "source.npz").write_bytes(b"of the demo")
    few = ("-k", 30, "-o", out)
    assert "got source.npz, which would stay beside the new one" in refused(capsys, *pair, *few)
    assert (out / "source.npz").read_bytes() == b"of the demo"
    write(creature(600), out / "source.npz")  # an input may lie there
    (out / "point_map.npy").write_bytes(b"old")
    report(capsys, out / "source.npz", pair[1], *few)
    assert len(np.load(out / "point_map.npy")) == 600
    for options in (
        (out / "source.npz", pair[1], *few, "--cloud", 700),
        (*pair, *few, "--truth", out / "point_map.npy"),
    ):
        assert "`output` must not replace an input, got" in refused(capsys, *options)


def test_bad_input_is_refused_before_the_work(files, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pair, out = (files / "source.off", files / "target.off"), ("-o", tmp_path / "out")
    not_two = "must hold lines of two integers"
    for text, message in {
        "# nothing\n": not_two,
        "nose ear\n": not_two,
        "1 2 # nose\n3\n": not_two,
        "1\n2\n": f"{not_two}, on the source and on the target, got '1' in line 1",
        f"1 {10**30}\n": not_two,
        "1 1_0\n": not_two,
        "5 650\n": "are the columns exchanged?",
    }.items():
        (tmp_path / "pairs.txt").write_text(text)
        assert message in refused(capsys, *pair, *out, "--landmarks", "pairs.txt")
    (tmp_path / "broken.npy").write_bytes(b"\x93NUMPY")
    np.save("short.npy", np.arange(7))
    np.save("beyond.npy", np.load(files / "truth.npy") + 100)
    np.savez("several.npz", a=np.arange(3))
    np.save("unknown.npy", np.where(np.arange(600) == 7, -1, np.load(files / "truth.npy")))
    truth, landmarks = files / "truth.npy", files / "landmarks.txt"
    for options, message in (
        (("--landmarks", truth), not_two),
        (("--landmarks", "none.txt"), "none.txt"),
        (("--truth", "broken.npy"), "not a whole npy file"),
        (("--truth", "short.npy"), "got int64 of shape (7,)"),
        (("--truth", "beyond.npy"), "are source and target exchanged?"),
        (("--truth", "several.npz"), "not a whole npy file of numbers (it begins"),
        (("--landmarks", landmarks, "--cloud", 700), "sample first"),
        (("--truth", truth, "--cloud", 700), "sample first"),
        (("--initial", "unknown.npy"), "are source and target exchanged?"),
        (("--initial", truth, "--aligned"), "--initial has no effect with --aligned; give one"),
        (("--part", "--aligned"), "--aligned has no effect with --part; match wholes"),
        (("-o", tmp_path / "no" / "out"), "cannot make"),
        (("-o", tmp_path / "broken.npy"), "a file has that name"),
        (("--part", "--landmarks", landmarks), "--landmarks has no effect with --part; match"),
        (("--part", "--precise"), "--precise has no effect with --part; match wholes, or leave"),
        (("--part", "--cloud", 700), "`--part` must match a mesh to a mesh, got a point cloud"),
        (("--components", "--part"), "--part has no effect with --components; match two parts"),
        (("--components", "--largest"), "--largest has no effect with --components; match two"),
        (("--components", "--truth", truth), "--truth has no effect with --components; match"),
        (("--components", "--solver", "dense"), "--solver has no effect with --components; match"),
        (("--precise", "--cloud", 700), "`--precise` must have a mesh as SOURCE"),
        (("-k", 20), "`-k` must be at least 30, got 20; solve for more (150 match best)"),
    ):
        assert message in refused(capsys, *pair, *out, *options)
    clouds = (files / "cloud.ply", files / "animal.off", "--components", *out)
    assert "`--components` must match a mesh to a mesh, got a" in refused(capsys, *clouds)
    assert not (tmp_path / "out").exists()
