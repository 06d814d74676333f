"""The documentation leaves nothing out: public names, pictures, packages, notebooks."""

import ast
import importlib
import importlib.util
import inspect
import json
import pkgutil
import re
import shlex
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

import pytest
from conftest import bumpy, moved

import spectra_kit
from spectra_kit import show
from spectra_kit.cli import main
from spectra_kit.cli.program import parse
from spectra_kit.geometry import write
from spectra_kit.show import explorer

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PUBLIC = sorted(
    module.name
    for module in pkgutil.iter_modules(spectra_kit.__path__)
    if not module.name.startswith("_")
)


def load(path: Path) -> ModuleType:
    """Import a file of docs/, which is no package."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def listed(page: str) -> set[str]:
    """Names that a page of the reference has: entries of its tables, and its constants."""
    text = (DOCS / "api" / page).read_text()
    tables = re.findall(r"\.\. autosummary::\n(?:   :.*\n)*\n((?:   \S+\n)+)", text)
    lines = re.findall(r"^(?:\.\. data:: (\w+)|- `([\w.]+) <)", text, re.M)
    return set("".join(tables).split()) | {constant or package for constant, package in lines}


def public_names(module: ModuleType) -> set[str]:
    """What a module exports; all that it defines where it does not say."""
    here = {
        name
        for name, value in vars(module).items()
        if not name.startswith("_") and getattr(value, "__module__", "") == module.__name__
    }
    return set(getattr(module, "__all__", here))


@pytest.mark.parametrize("name", PUBLIC)
def test_the_reference_has_every_public_name(name: str) -> None:
    module = importlib.import_module(f"spectra_kit.{name}")
    names = listed(f"{name}.rst")
    missing = sorted(public_names(module) - names)
    assert not missing, f"add them to docs/api/{name}.rst"
    for entry in names:  # as far as to functions of modules that are no packages
        *parents, attribute = entry.split(".")
        assert hasattr(importlib.import_module(".".join([module.__name__, *parents])), attribute)


def test_the_first_page_of_the_reference_has_all_packages_and_the_names_above_them() -> None:
    entries = {entry.removeprefix("~spectra_kit.") for entry in listed("index.rst")}
    assert {f"spectra_kit.{name}" for name in PUBLIC} <= entries
    for name in dir(spectra_kit):
        thing = getattr(spectra_kit, name)
        if not inspect.ismodule(thing) and not name.startswith("_"):
            home = next((entry for entry in entries if entry.endswith(f".{name}")), "")
            assert home, f"{name} is missing in docs/api/index.rst"
            package, _, attribute = home.rpartition(".")
            assert getattr(importlib.import_module(f"spectra_kit.{package}"), attribute) is thing


def test_the_picture_of_the_architecture_has_all_packages() -> None:
    architecture = load(DOCS / "architecture.py")
    packages = [name for row in architecture.layers() for name in row]
    assert sorted(packages) == PUBLIC
    assert sorted(architecture.PURPOSE) == PUBLIC
    drawn = re.findall(r'id="package-(\w+)"', (DOCS / "pictures/architecture.svg").read_text())
    assert drawn == packages, "draw it again: python docs/architecture.py"


def test_every_picture_is_shown() -> None:
    pages = "".join(path.read_text() for path in DOCS.glob("*.md"))
    shown = set(re.findall(r"\]\(pictures/(\S+)\)", pages))
    drawn = {path.name for path in (DOCS / "pictures").iterdir()}
    assert shown == drawn, "draw it with apps/make_pictures.py, or show it in docs/*.md"


def blocks(language: str, pages: Iterable[Path]) -> list[str]:
    """Code blocks of a language, those that doctest runs left out."""
    pattern = rf"```{language}\n(.*?)```"
    found = [code for page in pages for code in re.findall(pattern, page.read_text(), re.S)]
    return [code for code in found if not code.startswith(">>>")]


@pytest.mark.parametrize("page", ["gallery.md", "pictures.md"])
def test_the_calls_beside_pictures_can_be_made(page: str) -> None:
    # To draw them all takes minutes; their names and arguments go stale first.
    drawing = {**vars(show), **vars(explorer)}
    code = ast.parse("\n".join(blocks("python", [DOCS / page])))
    calls = [node for node in ast.walk(code) if isinstance(node, ast.Call)]
    known = [call for call in calls if isinstance(call.func, ast.Name) and call.func.id in drawing]
    assert known
    for call in known:
        assert isinstance(call.func, ast.Name)
        names = {keyword.arg: None for keyword in call.keywords if keyword.arg}
        inspect.signature(drawing[call.func.id]).bind(*call.args, **names)
    unknown = {call.func.id for call in calls if isinstance(call.func, ast.Name)} - set(drawing)
    assert not {name for name in unknown if name.startswith(("plot_", "animate_", "write_"))}


def test_the_command_lines_of_the_guide_are_accepted() -> None:
    lines = "\n".join(blocks("bash", DOCS.glob("*.md"))).splitlines()
    commands = [
        shlex.split(line, comments=True) for line in lines if line.startswith("spectra-kit")
    ]
    assert len(commands) > 3
    for _, *arguments in commands:
        parse(arguments)  # raises where it has no use for one


@pytest.mark.parametrize("page", ["brains", "cells", "parts"])
def test_the_commands_for_a_trade_run_on_its_files(page, tmp_path, monkeypatch, capsys) -> None:
    """Two shapes where the page has its files; every row of the table is there."""
    freesurfer = pytest.importorskip("nibabel", reason="it writes .pial").freesurfer
    monkeypatch.chdir(tmp_path)
    files = {"brains": ["subjects/{}/surf/lh.pial"], "cells": ["cells/{}.ply"]}
    (pattern,) = files.get(page, ["scans/monday/{}.ply"])
    for name, mesh in (("one", bumpy(162)), ("two", moved(bumpy(162), 1, 0, 0, scale=2.0))):
        path = Path(pattern.format(name))
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".pial":
            freesurfer.write_geometry(path, mesh.points, mesh.faces)
        else:
            write(mesh, path)
    for line in "\n".join(blocks("bash", [DOCS / f"{page}.md"])).splitlines():
        _, *arguments = shlex.split(line, comments=True)
        assert main([*arguments, "--nworkers", "0", "-q"]) == 0, capsys.readouterr().err
        table = Path(arguments[arguments.index("--csv") + 1]).read_text().splitlines()
        assert len(table) == 3
        assert "dna_by_area_1" in table[0] or "--distances" not in arguments


def write_notebook(path: Path, text: str) -> None:
    cells = [{"cell_type": "markdown", "source": text.splitlines(keepends=True)}]
    path.write_text(json.dumps({"cells": cells}))


def test_notebooks_become_pages_with_a_list_of_their_questions(tmp_path: Path) -> None:
    module = load(DOCS / "extensions/notebook_pages.py")
    source, pages = tmp_path / "source", tmp_path / "pages"
    source.mkdir()
    pages.mkdir()
    write_notebook(source / "a.ipynb", "# A\n\n**What is a?** This.")
    write_notebook(source / "b.ipynb", "# B\n\nWe ask. And\nwhy b?")
    (pages / "gone.ipynb").write_text("of a notebook that was renamed")
    module.gather(source, pages)
    assert sorted(path.name for path in pages.iterdir()) == ["a.ipynb", "b.ipynb"]
    assert (pages / "b.ipynb").read_bytes() == (source / "b.ipynb").read_bytes()
    assert module.listed(f"These:\n{module.BEGIN}- old\n", source).splitlines() == [
        "These:",
        module.BEGIN.strip(),
        "",
        "- [A](../notebooks/a.ipynb): What is a?",
        "- [B](../notebooks/b.ipynb): And why b?",
    ]


def test_the_repository_shows_what_the_build_writes() -> None:
    notebooks, commands = (
        load(DOCS / f"extensions/{name}.py") for name in ("notebook_pages", "command_help")
    )
    page = notebooks.PAGE.read_text()
    assert page == notebooks.listed(page, ROOT / "notebooks"), "build the site"
    page = commands.PAGE.read_text()
    assert page == commands.whole(page), "python docs/extensions/command_help.py"
    packages = load(DOCS / "extensions/package_list.py")
    page = packages.PAGE.read_text()
    assert page == packages.whole(page), "build the site"
