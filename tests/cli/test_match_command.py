"""The command that matches two shapes."""

import json
import os
from dataclasses import replace

import numpy as np
import pytest
from conftest import creature
from running import printed, record, refusal
from scipy.spatial.transform import Rotation

from spectra_kit.cli.quality import Side, doubts_of, quality_of
from spectra_kit.correspondence import bijectivity_errors, way_back
from spectra_kit.eigensolvers import eigensolve
from spectra_kit.geometry import creature_pair, mirrored, permuted, sphere, write
from spectra_kit.matching import match
from spectra_kit.operators import robust_laplacian

FILES = {"point_map.npy", "functional_map.npy", "report.json"}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """An animal, the same one renumbered, one bent, and the truth of both."""
    folder = tmp_path_factory.mktemp("shapes")
    mesh = creature(1000)
    copy, order = permuted(mesh, seed=1)
    write(mesh, folder / "animal.off")
    write(mesh.as_cloud(), folder / "cloud.ply")
    write(copy, folder / "permuted.off")
    write(mirrored(mesh), folder / "mirrored.off")
    np.save(folder / "order.npy", order)
    np.save(folder / "same.npy", np.arange(mesh.n))
    source, target, truth = creature_pair(1000, 900)
    write(source, folder / "source.off")
    write(target, folder / "target.off")
    np.save(folder / "truth.npy", truth)
    chosen = np.linspace(0, 899, 12).astype(int)
    np.savetxt(folder / "landmarks.txt", np.column_stack([truth[chosen], chosen]), fmt="%d")
    return folder


def report(capsys, *arguments):
    """Match in silence; return the report."""
    return record(capsys, "match", *arguments, "--no-pictures")


def refused(capsys, *arguments):
    return refusal(capsys, "match", *arguments, "--no-pictures")


def test_a_permuted_copy_gives_the_permutation(files, tmp_path, capsys):
    result = report(
        capsys,
        *(files / "animal.off", files / "permuted.off", "--truth", files / "order.npy"),
        *("-k", 150, "-o", tmp_path / "out"),
    )
    found = np.load(tmp_path / "out" / "point_map.npy")
    np.testing.assert_array_equal(found, np.load(files / "order.npy"))
    assert set(os.listdir(tmp_path / "out")) == FILES
    assert np.load(tmp_path / "out" / "functional_map.npy").shape == (150, 150)
    match = result["match"]
    assert match["mean_error"] == match["way_back_error"] == 0
    assert match["point_map_orientation"] == match["coverage"] == match["auc_to_10"] == 1
    assert match["orientation"] > 0.99
    assert match["convincing"]
    assert match["dirichlet_energy"] == pytest.approx(1, rel=1e-3)
    assert match["mirrored"] is match["ambiguous"] is False
    assert match["other_side"] > 1
    assert "doubts" not in match
    assert result["target"]["points"] == 1000
    saved = json.loads((tmp_path / "out" / "report.json").read_text())
    assert saved == {key: value for key, value in result.items() if key != "written"}


def test_a_mirrored_copy_is_recognised(files, tmp_path, capsys):
    result = report(
        capsys,
        *(files / "animal.off", files / "mirrored.off", "--truth", files / "same.npy"),
        *("-k", 150, "-o", tmp_path / "out"),
    )
    assert result["match"]["mirrored"] is True
    assert result["match"]["mean_error"] == 0
    assert result["match"]["orientation"] < -0.9


def test_a_bent_and_remeshed_copy_by_landmarks(files, tmp_path, capsys):
    result = report(
        capsys,
        *(files / "source.off", files / "target.off", "-k", 80, "-o", tmp_path / "out"),
        *("--truth", files / "truth.npy", "--landmarks", files / "landmarks.txt"),
    )
    assert result["landmarks"] == 12
    assert result["match"]["mean_error"] < 4
    assert result["match"]["orientation"] > 0.5


def test_clouds_are_matched_and_judged_as_far_as_they_can_be(files, tmp_path, capsys):
    result = report(
        capsys,
        *(files / "cloud.ply", files / "cloud.ply", "-k", 60, "-o", tmp_path / "out"),
    )
    assert result["source"]["kind"] == "cloud"
    assert result["match"]["coverage"] == 1
    assert result["match"]["way_back_error"] is None


def test_the_demo_draws_its_pictures(tmp_path, capsys):
    folder = tmp_path / "demo"
    command = ("match", "demo", "demo", "--points", 800, "-k", 40, "--dpi", 50, "-o", folder)
    out, _ = printed(capsys, *command)
    assert "dirichlet energy" in out
    assert "the map: the point of demo that each point of demo is" in out
    assert "mean error" in out
    pictures = {"correspondence.png", "functional_map.png", "errors.png"}
    assert set(os.listdir(folder)) == FILES | pictures | {"source.npz", "target.npz"}
    for name in os.listdir(folder):
        assert f"written: {folder / name}" in out


def test_the_way_back_is_that_of_the_library():
    """By as many modes as elsewhere: 100 where there are so many, not fewer."""
    mesh = creature(900)
    laplacian = robust_laplacian(mesh)
    side = Side("x", mesh, laplacian, eigensolve(laplacian, 110))
    rolled = np.roll(np.arange(mesh.n), 3)
    back = way_back(side.spectrum, side.spectrum, rolled)
    expected = bijectivity_errors(mesh, rolled, back).mean()
    assert quality_of(side, side, rolled)["way_back_error"] == expected
    fewer = side.spectrum.truncate(60)
    assert (way_back(fewer, fewer, rolled) != back).any()
    cut = side.spectrum.truncate(100)
    np.testing.assert_array_equal(way_back(cut, cut, rolled), back)


def test_every_doubt_is_told(files):
    mesh = creature(600)
    spectrum = eigensolve(robust_laplacian(mesh), 40)
    found = match(spectrum, spectrum, source_geometry=mesh, target_geometry=mesh)
    assert doubts_of(found) == ""
    for doubtful, why in (
        ({"margin": 1.01}, "another map scores nearly as well"),
        ({"mirror_margin": 0.5}, "one that mirrors scores better"),
        ({"orientation": 0.1}, "its orientation is not that of a whole map"),
        ({"orientation": None, "consistent": 0.5}, "it is in doubt which side of a cloud is out"),
        ({"coverage": 0.8}, "it covers hardly more of the source than chance would"),
        (
            {"candidates": (replace(found.candidates[0], score=0.6),)},
            "the surfaces look no more alike than unrelated ones",
        ),
        (
            {"mirrored": True, "orientation": -1.0, "mirror_margin": 0.5, "margin": 1.0},
            "another map scores nearly as well, one that does not mirror scores better",
        ),
    ):
        assert doubts_of(replace(found, **doubtful)) == why


def test_an_ambiguous_match_says_why(tmp_path, capsys):
    ball = sphere(subdivisions=3).geometry
    turn = Rotation.from_rotvec([0.3, 0.5, 0.7]).as_matrix()
    eggs = [tmp_path / "one.off", tmp_path / "other.off"]
    for path, points in zip(eggs, (ball.points, ball.points @ turn), strict=True):
        write(ball.with_points(points * [1.0, 1.0, 1.7]), path)
    result = report(capsys, *eggs, "-k", 40, "--sides", "kept", "-o", tmp_path / "out")
    assert result["match"]["ambiguous"] is True
    assert "another map scores nearly as well" in result["match"]["doubts"]
    assert result["match"]["other_side"] is None  # not tried


def test_files_of_another_match_are_not_mixed_with_its_own(files, tmp_path, capsys):
    pair, out = (files / "animal.off", files / "permuted.off"), tmp_path / "out"
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    few = ("-k", 40, "-o", out)
    report(capsys, *pair, *few)
    report(capsys, *pair, *few)  # all is replaced
    (out / "source.npz").write_bytes(b"of the demo")
    assert "got source.npz, which would stay beside the new one" in refused(capsys, *pair, *few)
    assert (out / "source.npz").read_bytes() == b"of the demo"
    write(creature(1000), out / "source.npz")
    report(capsys, out / "source.npz", pair[1], *few)  # an input may lie there
    for options in (
        (out / "source.npz", pair[1], *few, "--cloud", 700),
        (*pair, *few, "--truth", out / "point_map.npy"),
    ):
        assert "the output must not replace an input, got" in refused(capsys, *options)


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
        "5 950\n": "are the columns exchanged?",
    }.items():
        (tmp_path / "pairs.txt").write_text(text)
        assert message in refused(capsys, *pair, *out, "--landmarks", "pairs.txt")
    (tmp_path / "broken.npy").write_bytes(b"\x93NUMPY")
    np.save("short.npy", np.arange(7))
    np.savez("several.npz", a=np.arange(3))
    truth, landmarks = files / "truth.npy", files / "landmarks.txt"
    for options, message in (
        (("--landmarks", truth), not_two),
        (("--landmarks", "none.txt"), "none.txt"),
        (("--truth", "broken.npy"), "not a whole npy file"),
        (("--truth", "short.npy"), "got int64 of shape (7,)"),
        (("--truth", "several.npz"), "not a whole npy file of numbers (it begins"),
        (("--truth", truth, "--repair"), "repair or sample first"),
        (("--landmarks", landmarks, "--cloud", 700), "repair or sample first"),
        (("-o", tmp_path / "no" / "out"), "cannot make"),
    ):
        assert message in refused(capsys, *pair, *out, *options)
    assert not (tmp_path / "out").exists()
