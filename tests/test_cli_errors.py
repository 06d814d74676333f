"""Errors of the command line: a line that says what to do, an exit code, nothing half written."""

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

from spectra_kit import eigensolve, robust_laplacian
from spectra_kit.cli import main, run
from spectra_kit.cli.folder import together
from spectra_kit.cli.story import COMMANDS
from spectra_kit.geometry import TriangleMesh, creature, sphere, write

NAMES = [command.name for command in COMMANDS if command.name != "completion"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    write(sphere(subdivisions=2).geometry, folder / "ball.off")
    (folder / "empty.off").touch()
    (folder / "text.docx").write_text("words")
    (folder / "sub").mkdir()
    return folder


def refused(capsys, *arguments, code=2):
    """Run a command that must be refused in one line; return it."""
    assert main([*map(str, arguments)]) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    return err


@pytest.mark.parametrize("name", NAMES)
def test_every_command_refuses_bad_files_in_one_line(name, folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    before = sorted(os.listdir(folder))
    second = ["ball.off"] if name == "match" else []
    source = ["--source", "0"] if name == "geodesic" else []
    for file, message in (
        ("bal.off", "bal.off: there is no such file; did you mean 'ball.off'?"),
        ("none.off", "none.off: there is no such file; looked from"),
        ("sub", "sub: this is a folder, expected a file; name one that is in it"),
        ("empty.off", "empty.off: the file is empty"),
        ("-", "-: pipes are not read, expected a file whose name ends in its format (obj, off"),
        ("/dev/stdin", "/dev/stdin: pipes are not read, expected a file"),
        ("text.docx", "cannot read the format '.docx'; known are .glb, "),
    ):
        assert message in refused(capsys, name, file, *second, *source)
    with pytest.raises(SystemExit, match=r"^2$"):
        main([name])
    assert "error: the following arguments are required" in capsys.readouterr().err
    assert main([name, "none.off", *second, *source, "--debug"]) == 2
    assert "Traceback (most recent call last)" in capsys.readouterr().err
    assert sorted(os.listdir(folder)) == before


@pytest.mark.parametrize(
    ("name", "option", "suffix", "known"),
    [
        ("spectrum", "-o", ".npz", ".npz"),
        ("spectrum", "--picture", ".png", ".png or .pdf or .svg"),
        ("modes", "-o", ".png", ".png or .pdf or .svg"),
        ("animate", "-o", ".gif", ".gif or .mp4"),
        ("compare", "-o", ".png", ".png or .pdf or .svg"),
        ("explore", "-o", ".html", ".html or .htm"),
    ],
)
def test_outputs_are_checked_before_the_work(name, option, suffix, known, folder, capsys, tmp_path):
    ball = folder / "ball.off"
    bad = tmp_path / "out.doc"
    assert f"must be a {known} file, got" in refused(capsys, name, ball, option, bad)
    nowhere = tmp_path / "no" / f"out{suffix}"
    assert "there is no folder" in refused(capsys, name, ball, option, nowhere)
    (tmp_path / f"dir{suffix}").mkdir()
    taken = tmp_path / f"dir{suffix}"
    assert "a folder has that name" in refused(capsys, name, ball, option, taken)
    assert os.listdir(tmp_path) == [f"dir{suffix}"]


@pytest.mark.skipif(not hasattr(os, "setresuid"), reason="there are no such rights here")
def test_a_folder_without_rights_is_told_before_the_work(capsys):
    with tempfile.TemporaryDirectory() as name:  # not in a folder that only its owner may enter
        closed = Path(name)
        closed.chmod(0o555)
        superuser = os.getuid() == 0
        if superuser:  # who may write everywhere
            os.setresuid(65534, 65534, 0)
        try:
            message = refused(capsys, "spectrum", "demo", "-o", closed / "out.npz")
        finally:
            if superuser:
                os.setresuid(0, 0, 0)
            closed.chmod(0o755)
    assert "is not yours to write to; name another place" in message


@pytest.mark.skipif(not os.path.exists("/proc/self"), reason="there is no /proc here")
def test_a_file_that_cannot_be_made_has_its_own_name(folder, capsys):
    """The superuser too cannot write there, though he has the right to."""
    ball = folder / "ball.off"
    for place, command in (
        ("/proc/foo.npz", ("spectrum", ball, "-k", "4")),
        ("/proc/foo", ("geodesic", ball, "--source", "0", "--no-pictures")),
    ):
        message = refused(capsys, *command, "-o", place)
        assert message.startswith(f"error: {place}: ") or "is not yours to write" in message


def test_an_output_never_replaces_an_input(capsys, tmp_path):
    write(sphere(subdivisions=1).geometry, tmp_path / "ball.npz")
    before = (tmp_path / "ball.npz").read_bytes()
    again = ("spectrum", tmp_path / "ball.npz", "-k", 4, "-o", tmp_path / "ball.npz")
    assert "the output must not replace an input, got" in refused(capsys, *again)
    assert (tmp_path / "ball.npz").read_bytes() == before


def test_an_existing_output_is_replaced(folder, capsys, tmp_path):
    for k in (4, 6):
        out = tmp_path / "modes.npz"
        assert main(["spectrum", str(folder / "ball.off"), "-k", str(k), "-o", str(out)]) == 0
    assert np.load(out)["eigenvalues"].shape == (6,)
    assert os.listdir(tmp_path) == ["modes.npz"]


def test_a_bug_is_called_one(capsys):
    def breaks(_):
        return [][1]

    assert run(breaks, argparse.Namespace(debug=False, quiet=False)) == 1
    err = capsys.readouterr().err
    assert err == (
        "error: this is a bug of spectra_kit: IndexError: list index out of range; please report it"
        " with what --debug shows\n"
    )
    assert run(breaks, argparse.Namespace(debug=True, quiet=False)) == 1
    assert "in breaks" in capsys.readouterr().err


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full here")
def test_a_full_disk_behind_stdout(folder):
    command = [sys.executable, "-m", "spectra_kit", "info", str(folder / "ball.off")]
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    assert (done.returncode, done.stderr) == (2, "error: no space left on device\n")


def test_files_of_a_folder_appear_together_or_not_at_all(tmp_path):
    results = tmp_path / "results"
    with together(results, replacing=()) as part:
        (part / "numbers.txt").write_text("old")
        assert not results.exists()
    (results / "picture.png").write_text("of the old numbers")
    with pytest.raises(KeyboardInterrupt), together(results, replacing=["picture.png"]) as part:
        raise (part / "numbers.txt").write_text("new") and KeyboardInterrupt
    assert (results / "numbers.txt").read_text() == "old"
    assert sorted(os.listdir(results)) == ["numbers.txt", "picture.png"]
    with together(results, replacing=["picture.png"]) as part:
        (part / "numbers.txt").write_text("new")
    assert (results / "numbers.txt").read_text() == "new"
    assert os.listdir(results) == ["numbers.txt"]
    assert os.listdir(tmp_path) == ["results"]


def test_saved_modes_must_be_of_this_geometry_and_operator(folder, capsys, tmp_path):
    ball, saved = folder / "ball.off", tmp_path / "ball.npz"
    mesh = sphere(subdivisions=2).geometry
    eigensolve(robust_laplacian(mesh), 6).save(saved)
    page = tmp_path / "page.html"
    command = ("--spectrum", saved, "--solver", "none", "-o", page)
    assert main(["explore", str(ball), *map(str, command), "-k", "5"]) == 0
    assert "5 modes on all 162 points" in capsys.readouterr().out
    page.unlink()
    other = tmp_path / "other.off"
    write(creature(500), other)
    message = refused(capsys, "explore", other, *command)
    assert f"{saved} holds modes of something else: `laplacian` must live on the 162" in message
    bent = TriangleMesh(mesh.points * [1, 1, 1.01], mesh.faces)
    write(bent, other)
    assert "holds modes of something else" in refused(capsys, "explore", other, *command)
    knn = ("explore", ball, *command, "--operator", "knn")
    assert "holds modes of something else" in refused(capsys, *knn)
    assert "leave --spectrum out" in refused(capsys, *knn)
    swapped = TriangleMesh(mesh.points[::-1], 161 - mesh.faces)  # the same, in another order
    write(swapped, other)
    assert "holds modes of something else" in refused(capsys, "explore", other, *command)
    assert not page.exists()
    assert "found no file" in refused(capsys, "modes", ball, "--spectrum", tmp_path / "none.npz")
    assert "not a whole spectrum file" in refused(capsys, "modes", ball, "--spectrum", ball)


@pytest.mark.parametrize(
    ("command", "key"),
    [
        (("spectrum", "--picture", "x.png", "--dpi", "0"), "eigenvalues"),
        (("compare", "--solver", "dense", "-o", "x.png", "--turn", "nan"), "comparison"),
    ],
)
def test_a_drawing_that_fails_keeps_the_numbers(
    command, key, folder, capsys, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    name, *options = command
    for form in ((), ("--json",)):
        assert main([name, str(folder / "ball.off"), "-k", "4", *options, *form]) == 2
        out, err = capsys.readouterr()
        assert err.startswith("the numbers are whole, but not drawn: x.png\nerror: `")
        if form:
            told = json.loads(out)
            assert told[key]
            assert told["picture"] is None
        else:
            assert "largest relative residual" in out
            assert "picture" not in out
    assert os.listdir() == []


@pytest.mark.skipif(os.name != "posix", reason="there is no Ctrl-C for a process alone here")
@pytest.mark.parametrize(
    ("command", "numbers", "pictures"),
    [
        (
            ("match", "demo", "demo", "-k", "30"),
            ("functional_map.npy", "point_map.npy", "report.json", "source.npz", "target.npz"),
            ("correspondence.png", "functional_map.png", "errors.png"),
        ),
        (("geodesic", "demo"), ("distance.npy", "distance.ply", "report.json"), ("field.png",)),
        (
            ("spectrum", "demo", "-k", "9", "--picture", "out/plot.png", "--dpi", "900"),
            ("modes.npz",),
            (),
        ),
    ],
    ids=lambda part: part[0] if part else "",
)
def test_ctrl_c_while_drawing_keeps_the_numbers_and_names_what_is_missing(
    command, numbers, pictures, tmp_path
):
    out = tmp_path / "out"
    out.mkdir()
    target = Path("out") if pictures else Path("out", "modes.npz")
    screen, terminal = os.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "spectra_kit", *command, "--points", "500", "-o", str(target)],
        stdout=subprocess.PIPE,
        stderr=terminal,
        text=True,
        cwd=tmp_path,
    )
    os.close(terminal)
    told = ""
    while "drawing" not in told:  # on a terminal it says what it does
        told += os.read(screen, 4096).decode(errors="replace")
    process.send_signal(signal.SIGINT)
    with contextlib.suppress(OSError):  # how a terminal says that its last writer has gone
        while chunk := os.read(screen, 4096):
            told += chunk.decode(errors="replace")
    os.close(screen)
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 130
    assert bool(said) == (not pictures)  # what has a folder of its own prints at the end
    assert pictures or "largest relative residual" in said
    assert sorted(os.listdir(out)) == list(numbers)
    missing = ", ".join(f"out/{name}" for name in pictures or ["plot.png"])
    kept = "the numbers in out are" if pictures else f"the spectrum {target} is"
    assert told.endswith(f"{kept} whole, but not drawn: {missing}\r\ninterrupted\r\n")
