"""The command that carries values, labels and landmarks along maps that `match` has written."""

import os

import numpy as np
import pytest
from conftest import bumpy
from running import record, refusal

from spectra_kit.geometry import creature_pair, permuted, read, read_overlay, write
from spectra_kit.maps import Carrier


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A bumpy ball and its renumbered copy, with the map between both; values of the first."""
    folder = tmp_path_factory.mktemp("carry")
    mesh = bumpy(162)
    copy, order = permuted(mesh, seed=1)
    write(mesh, folder / "a.off")
    write(copy, folder / "b.off")
    (folder / "maps").mkdir()
    np.save(folder / "maps" / "point_map.npy", order)
    np.save(folder / "heights.npy", mesh.points[:, 2])
    np.save(folder / "halves.npy", (mesh.points[:, 2] > 0).astype(int))
    np.savetxt(folder / "halves.csv", mesh.points[:, 2] > 0, "%d")
    np.savetxt(folder / "places.csv", mesh.points, "%.17g", ",", header="x,y,z", comments="")
    np.save(folder / "of_faces.npy", np.arange(len(mesh.faces)))
    np.savetxt(folder / "marks.csv", [7, 40], "%d")
    return folder


def carry(folder, capsys, values, out, *options):
    pair = (folder / "a.off", folder / "b.off")
    return record(
        capsys, "carry", *pair, folder / values, "--maps", folder / "maps", "-o", out, *options
    )


def test_what_a_renumbered_copy_has_is_renumbered(folder, tmp_path, capsys):
    order, mesh = np.load(folder / "maps" / "point_map.npy"), read(folder / "a.off")
    told = carry(folder, capsys, "heights.npy", tmp_path / "z.npy")
    assert told["kind"] == "values of vertices"
    assert told["undefined"] == 0
    np.testing.assert_array_equal(np.load(tmp_path / "z.npy"), mesh.points[order, 2])
    for name in ("halves.npy", "halves.csv"):
        told = carry(folder, capsys, name, tmp_path / "half.csv")
        assert told["kind"] == "labels of vertices"
        assert 0.5 < told["confidence"] < 1
        carried = np.loadtxt(tmp_path / "half.csv", dtype=int)
        np.testing.assert_array_equal(carried, mesh.points[order, 2] > 0)
    carry(folder, capsys, "places.csv", tmp_path / "xyz.csv")
    np.testing.assert_array_equal(
        np.loadtxt(tmp_path / "xyz.csv", delimiter=","), mesh.points[order]
    )


def test_faces_landmarks_and_files_of_others(folder, tmp_path, capsys):
    one, other = read(folder / "a.off"), read(folder / "b.off")
    order = np.load(folder / "maps" / "point_map.npy")
    told = carry(folder, capsys, "of_faces.npy", tmp_path / "faces.npy")
    assert told["kind"] == "labels of faces"
    same = np.sort(order[other.faces], axis=1)
    found = np.sort(one.faces[np.load(tmp_path / "faces.npy")], axis=1)
    np.testing.assert_array_equal(found, same)
    carry(folder, capsys, "marks.csv", tmp_path / "marks.csv", "--marks")
    rows = np.loadtxt(tmp_path / "marks.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(rows[:, :3], one.points[[7, 40]], atol=1e-12)
    at = np.einsum("pc,pcr->pr", rows[:, 4:], other.points[other.faces[rows[:, 3].astype(int)]])
    np.testing.assert_allclose(at, rows[:, :3], atol=1e-12)
    carry(folder, capsys, "heights.npy", tmp_path / "there.ply")
    np.testing.assert_array_equal(read(tmp_path / "there.ply").faces, other.faces)
    carry(folder, capsys, "heights.npy", tmp_path / "there.curv")
    np.testing.assert_allclose(
        read_overlay(tmp_path / "there.curv").values, one.points[order, 2], rtol=1e-6
    )


def test_what_match_writes_is_read(tmp_path, capsys):
    source, target, _ = creature_pair(700, 600, seed=1)
    write(source, tmp_path / "a.off")
    write(target, tmp_path / "b.off")
    pair = (tmp_path / "a.off", tmp_path / "b.off")
    for options in ((), ("--precise",)):
        maps = tmp_path / f"maps{len(options)}"
        record(capsys, "match", *pair, "-k", 60, "--no-pictures", "-o", maps, *options)
        np.save(tmp_path / "places.npy", source.points)
        out = tmp_path / "there.npy"
        record(capsys, "carry", *pair, tmp_path / "places.npy", "--maps", maps, "-o", out)
        plain = Carrier(source, target, np.load(maps / "point_map.npy")).values(source.points)
        apart = np.linalg.norm(np.load(out) - plain, axis=1)
        assert (apart == 0).all() if not options else 0 < apart.mean() < 0.1
    # A point without a partner has nothing.
    point_map = np.load(maps / "point_map.npy")
    point_map[5] = -1
    np.save(tmp_path / "maps0" / "point_map.npy", point_map)
    told = record(
        capsys, "carry", *pair, tmp_path / "places.npy", "--maps", tmp_path / "maps0", "-o", out
    )
    assert told["undefined"] == 1
    assert np.isnan(np.load(out)[5]).all()


def test_it_refuses(folder, tmp_path, capsys):
    a, b = folder / "a.off", folder / "b.off"
    out = tmp_path / "out.npy"

    def refused(*given, maps=folder / "maps", to=out):
        return refusal(capsys, "carry", *given, "--maps", maps, "-o", to)

    assert "holds no point_map.npy" in refused(a, b, folder / "heights.npy", maps=tmp_path)
    np.save(tmp_path / "three.npy", np.zeros(3))
    assert "holds 3 rows" in refused(a, b, tmp_path / "three.npy")
    assert "be a .npy or .csv" in refused(a, b, folder / "of_faces.npy", to=tmp_path / "x.ply")
    (tmp_path / "words.csv").write_text("1\nnone\n")
    assert "not a table of numbers" in refused(a, b, tmp_path / "words.csv")
    for wrong in (np.array(3.0), np.zeros((162, 2, 3)), np.zeros((162, 0))):
        np.save(tmp_path / "odd.npy", wrong)
        assert "expected a row for each vertex" in refused(a, b, tmp_path / "odd.npy")
    (tmp_path / "huge.csv").write_text("99999999999999999999\n" * 162)
    carried = tmp_path / "huge.npy"
    pair = (a, b, tmp_path / "huge.csv", "--maps", folder / "maps", "-o", carried)
    assert record(capsys, "carry", *pair)["kind"] == "values of vertices"  # none wraps round
    np.testing.assert_array_equal(np.load(carried), 1e20)
    again = folder / "maps" / "point_map.npy"
    assert "not replace an input" in refused(a, b, folder / "heights.npy", to=again)
    assert "not replace an input" in refused(a, b, folder / "marks.csv", to=folder / "marks.csv")
    write(bumpy(642), tmp_path / "fine.off")
    assert "is no map from 642 points" in refused(a, tmp_path / "fine.off", folder / "heights.npy")
    assert not os.path.exists(out)
