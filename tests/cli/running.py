"""How tests of the command line run it: in this process, as a person would type it."""

import json

import pytest

from spectra_kit.cli import main
from spectra_kit.geometry import rectangle, sphere, write


def printed(capsys, *arguments):
    """Run a command that must succeed; return what it printed, and what it said besides."""
    code = main([*map(str, arguments)])
    out, err = capsys.readouterr()
    if code == 2 and "OpenGL" in err:
        pytest.skip("no OpenGL library on this machine")
    assert code == 0, err
    return out, err


def record(capsys, *arguments):
    """Run a command that must succeed in silence; return its JSON."""
    out, err = printed(capsys, *arguments, "--json")
    assert err == ""
    return json.loads(out)


def refusal(capsys, *arguments):
    """Run a command that must be refused in one line; return it."""
    assert main([*map(str, arguments)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    return err


def write_shapes(folder):
    """Write a sphere, its points and a sheet as ball.off, cloud.ply and sheet.off."""
    ball = sphere(subdivisions=3).geometry
    write(ball, folder / "ball.off")
    write(ball.as_cloud(), folder / "cloud.ply")
    write(rectangle(n=400).geometry, folder / "sheet.off")
    return ball
