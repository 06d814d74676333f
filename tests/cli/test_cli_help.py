"""What the help says, and that it is true."""

import json
import re

import numpy as np
import pytest
from conftest import creature
from running import printed

from spectra_kit.cli import main
from spectra_kit.cli.program import COMMANDS, app, load, parse
from spectra_kit.datasets import Plan, SpectrumStore, complete
from spectra_kit.features import ShapeDNA
from spectra_kit.geometry import TriangleMesh, sphere, write
from spectra_kit.learn import NearestNeighbour, Recipe, save_labeller, train_classifier

NAMES = [*COMMANDS]
SMALL = ("demo", "--points", "500", "-q", "--json")
CHEAP = {  # what is not SMALL with four modes
    "info": SMALL,
    "modes": (*SMALL, "-k", "4", "--dpi", "40"),
    "animate": (*SMALL, "-k", "4", "--modes", "1", "--seconds", "0.1", "--width", "64"),
    "compare": (*SMALL, "-k", "4", "--solver", "dense"),
    "explore": (*SMALL, "-k", "4", "--solver", "none", "-o", "page.html"),
    "geodesic": (*SMALL, "--no-pictures"),
    "path": (*SMALL, "--no-pictures"),
    "curvature": ("demo", "--points", "8000", "--no-pictures", "-q", "--json"),
    "smooth": SMALL,
    "match": ("a.off", "b.off", "-q", "--json", "-k", "30", "--no-pictures"),
    "carry": ("a.off", "a.off", "u.npy", "--maps", ".", "-q", "--json"),
    "similar": ("a.off", ".", "-q", "--json", "-k", "20"),
    "label": ("a.off", "known.safetensors", "-q", "--json"),
    "batch": ("a.off", "-o", "spectra", "-q", "--json", "-k", "4", "--nworkers", "0"),
    "match-all": ("known", "--pairs", "all", "-q", "--json", "--nworkers", "0"),
    "store": ("list", "known", "-q", "--json"),
    "completion": ("bash", "--json"),
}


def help_of(capsys, monkeypatch, *arguments, width=80):
    monkeypatch.setenv("COLUMNS", str(width))
    return printed(capsys, *arguments, "--help")[0]


def test_the_story_has_each_command_with_an_example(capsys, monkeypatch):
    story = help_of(capsys, monkeypatch)
    assert max(map(len, story.splitlines())) <= 79
    told = re.findall(r"^  ([\w-]+) .*  spectra-kit ([\w-]+) \S", story, flags=re.MULTILINE)
    assert told == [(name, name) for name in NAMES]
    assert story.count("\n") <= len(NAMES) + 7, "a line for each command, and little beside"
    assert "Exit codes: 0 fine, 1 bug, 2 bad usage or file, 3 solver failed" in story


@pytest.mark.parametrize("name", NAMES)
def test_help_begins_with_a_purpose_and_its_examples_and_options_parse(name, capsys, monkeypatch):
    text = help_of(capsys, monkeypatch, name)
    assert max(map(len, text.splitlines())) <= 80
    assert text.startswith(f"Usage: spectra-kit {name} ")
    examples = re.findall(r"^ spectra-kit (.*)$", text, flags=re.MULTILINE)
    assert COMMANDS[name][1] == examples[0].strip()
    for example in examples:
        parse(example.split(" >")[0].split())
    for flag in ("--json", "--quiet", "--debug"):
        assert flag in text.split(" general ")[1]
    two = {key: ["a", "b"] for key in ("match", "similar", "label")} | {"carry": ["a", "b", "c"]}
    files, given = {**two, "store": ["list", "a"], "completion": ["bash"]}.get(name, ["a"]), []
    for option in app(name)[name].assemble_argument_collection():
        if option.show and option.index is None:
            choices, (count, _) = option.get_choices(), option.token_count()
            assert option.name in text
            given += [option.name, *[choices[0] if choices else "1"] * count]
    assert parse([name, *files, *given])[0].json


def test_help_keeps_to_a_narrow_terminal(capsys, monkeypatch):
    text = help_of(capsys, monkeypatch, "geodesic", width=60)
    assert max(map(len, text.splitlines())) <= 60


def test_one_word_has_one_meaning_over_all_commands():
    """An option of a name has the same type wherever it is, and takes the same choices."""
    meanings = {}
    for name in NAMES:
        for option in app(name)[name].assemble_argument_collection():
            if option.show:
                choices = set(option.get_choices() or ()) - {"none"}
                meanings.setdefault(option.name, set()).add(frozenset(choices))
    assert {name for name, kinds in meanings.items() if len(kinds) > 1} == set()


@pytest.mark.parametrize("name", NAMES)
def test_json_is_one_object_with_the_keys_that_the_help_names(name, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    store = SpectrumStore("known")
    if name in ("match", "similar", "label", "batch"):
        ball = sphere(subdivisions=2).geometry
        for file in ("a.off", "b.off"):
            write(TriangleMesh(ball.points * [1, 1.2, 1.5], ball.faces), file)
        recipe = Recipe(embeddings=(ShapeDNA(count=3),), k=5)
        known = train_classifier([ball, ball], [0, 1], recipe=recipe, method=NearestNeighbour())
        save_labeller("known.safetensors", known)
    if name == "carry":
        write(sphere(subdivisions=0).geometry, "a.off")
        for file in ("u.npy", "point_map.npy"):
            np.save(file, np.arange(12))
    if name == "match-all":
        write(creature(600), "a.off")
        for animal in ("cat", "lion"):
            complete(store, animal, "a.off", Plan(k=30))
    out, err = printed(capsys, name, *CHEAP.get(name, (*SMALL, "-k", "4")))
    assert err == ""
    assert out.count("\n") < 120  # the numbers of an array are on one line
    keys = re.split(r",\s*", load(name)[0].keys)
    optional = {"faces", "comparison"} if name == "geodesic" else set()
    assert set(json.loads(out)) - optional == set(keys) - optional


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["spektrum", "demo"], 'Did you mean "spectrum"?'),
        (["spectrum", "demo", "--solver", "apack"], 'Did you mean "arpack"?'),
        (["spectrum", "demo", "--sovler", "arpack"], "Did you mean --solver?"),
        (["geodesic", "demo", "--heat-boundary", "neuman"], 'Did you mean "neumann"?'),
        (["fly"], "; see spectra-kit --help"),
        ([], "a command is required; see spectra-kit --help"),
        (["spectrum"], "FILE is required; see spectra-kit spectrum --help"),
        (["spectrum", "demo", "--xyzzy"], "; see spectra-kit spectrum --help"),
        (["info", "a", "b"], "unrecognized arguments: b; see spectra-kit info --help"),
        (["spectrum", "a", "--modes", "1,x"], "expected numbers like 1,2,5,10, got '1,x'"),
        (["geodesic", "a", "--at", "1", "2"], "--at requires 3"),
    ],
)
def test_wrong_usage_ends_with_2_and_a_hint(arguments, message, capsys):
    assert main(arguments) == 2
    usage, error = capsys.readouterr().err.splitlines()
    assert usage.startswith("usage: spectra-kit ")
    assert error.startswith("error: ")
    assert message in error


def test_version(capsys):
    assert printed(capsys, "--version")[0].startswith("spectra_kit ")
