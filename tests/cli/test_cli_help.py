"""What the help says, and that it is true."""

import json
import re

import pytest
from test_apps import load

from spectra_kit.cli import main
from spectra_kit.cli.parser import did_you_mean
from spectra_kit.cli.story import COMMANDS, build_parser
from spectra_kit.geometry import TriangleMesh, sphere, write

NAMES = [command.name for command in COMMANDS]
SMALL = ("demo", "--points", "500", "-q", "--json")
CHEAP = {
    "info": SMALL,
    "spectrum": (*SMALL, "-k", "4"),
    "compare": (*SMALL, "-k", "4", "--solver", "dense"),
    "explore": (*SMALL, "-k", "4", "--solver", "none", "-o", "page.html"),
    "geodesic": (*SMALL, "--no-pictures"),
    "match": ("a.off", "b.off", "-q", "--json", "-k", "40", "--no-pictures"),
    "completion": ("bash", "--json"),
}


def help_of(capsys, monkeypatch, *arguments, width=80):
    monkeypatch.setenv("COLUMNS", str(width))
    with pytest.raises(SystemExit, match=r"^0$"):
        main([*arguments, "--help"])
    return capsys.readouterr().out


def test_the_story_has_each_command_with_an_example(capsys, monkeypatch):
    story = help_of(capsys, monkeypatch)
    assert max(map(len, story.splitlines())) <= 79
    told = re.findall(r"^  (\w+) .*  spectra-kit (\w+) \S", story, flags=re.MULTILINE)
    assert told == [(name, name) for name in NAMES]
    assert len(told) <= 10
    assert story.count("\n") <= 15
    assert "Exit codes: 0 fine, 1 bug, 2 bad usage or file, 3 solver failed" in story


@pytest.mark.parametrize("name", NAMES)
def test_help_begins_with_a_purpose_and_examples_that_parse(name, capsys, monkeypatch):
    text = help_of(capsys, monkeypatch, name)
    assert max(map(len, text.splitlines())) <= 80
    usage, _, purpose = text.splitlines()[:3]
    assert usage.startswith(f"usage: spectra-kit {name} ")
    assert purpose[0].isupper()
    examples = re.findall(r"^  spectra-kit (.*)$", text, flags=re.MULTILINE)
    assert 2 <= len(examples) <= 3
    for example in examples:
        words = example.split(" >")[0].split()
        assert build_parser().parse_args(words).parser.prog == f"spectra-kit {name}"
    for flag in ("--json", "--quiet", "--debug", "--help"):
        assert flag in text.split("general:")[1]
    narrow = help_of(capsys, monkeypatch, name, width=60)
    options = narrow.split("general:")[1].split("keys of")[0]
    assert max(map(len, options.splitlines())) <= 60


def test_every_option_with_a_default_says_which(capsys, monkeypatch):
    for name in NAMES:
        for action in vars(build_parser().parse_args([name, *_needed(name)]).parser)["_actions"]:
            if action.default not in (None, False, []) and action.dest != "help":
                assert "default" in (action.help or ""), (name, action.dest)


def _needed(name):
    return {"match": ["a", "b"], "completion": ["bash"]}.get(name, ["a"])


@pytest.mark.parametrize("name", CHEAP)
def test_json_is_one_object_with_the_keys_that_the_help_names(name, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    if name == "match":
        ball = sphere(subdivisions=2).geometry
        for file in ("a.off", "b.off"):
            write(TriangleMesh(ball.points * [1, 1.2, 1.5], ball.faces), file)
    assert main([name, *CHEAP[name]]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert out.count("\n") < 120  # the numbers of an array are on one line
    keys = re.split(r",\s*", next(c.keys for c in COMMANDS if c.name == name))
    optional = {"faces", "comparison"} if name == "geodesic" else set()
    assert set(json.loads(out)) - optional == set(keys) - optional


@pytest.mark.parametrize("app", ["compare_modes", "match_shapes", "geodesic_distances"])
def test_the_apps_explain_themselves_in_80_columns(app, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit, match=r"^0$"):
        load(app).main(["--help"])
    text = capsys.readouterr().out
    assert f"python apps/{app}.py" in text
    assert max(map(len, text.splitlines())) <= 80


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        (["spektrum", "demo"], "did you mean 'spectrum'?"),
        (["spectrum", "demo", "--solver", "apack"], "did you mean 'arpack'?"),
        (["spectrum", "demo", "--sovler", "arpack"], "did you mean '--solver'?"),
        (["geodesic", "demo", "--boundary", "neuman"], "did you mean 'neumann'?"),
        (["fly"], "see spectra-kit --help"),
        (["spectrum", "demo", "--xyzzy"], "see spectra-kit spectrum --help"),
    ],
)
def test_what_may_have_been_meant(arguments, hint, capsys):
    with pytest.raises(SystemExit, match=r"^2$"):
        main(arguments)
    err = capsys.readouterr().err
    assert err.endswith(f"; {hint}\n")
    assert len(err.splitlines()) == 2  # the usage, and what is wrong


def test_nothing_is_meant_where_nothing_is_near():
    assert did_you_mean("xyzzy", ["arpack", "neo"]) == ""
