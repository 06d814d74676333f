"""Imports point down, from room to room and from file to file, and say so where they stand."""

import ast
import re
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2] / "spectra_kit"
LAYERS = [
    "errors",
    "_core",
    "geometry _sparse catalogue",
    "operators",
    "eigen",
    "neo",
    "features geodesics",
    "maps",
    "datasets interop show",
    "learn",
    "cli",
    "__main__",
]
LEVEL = {name: i for i, row in enumerate(LAYERS) for name in row.split()}
#: The one arrow that goes up: the solver stands beside the others, above the network.
UPWARD = {("eigen.neo", "neo")}
#: What imports by a string: packages that may be absent, and what is chosen by name.
BY_NAME = {"_core/optional.py", "catalogue.py", "cli/program.py"}
FILES = sorted(p for p in ROOT.rglob("*.py") if p != ROOT / "__init__.py")


def dotted(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {dotted(path) for path in FILES}


def imports(source: str) -> set[str]:
    """Modules of spectra_kit that `source` imports, those for type checkers alone left out."""

    def walk(node: ast.AST):
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.If) and ast.unparse(child.test) == "TYPE_CHECKING":
                continue
            if isinstance(child, ast.ImportFrom) and (child.module or "").startswith("spectra_kit"):
                module = (child.module or "").removeprefix("spectra_kit").removeprefix(".")
                for alias in child.names:
                    inner = f"{module}.{alias.name}".removeprefix(".")
                    yield inner if inner in MODULES else module
            if isinstance(child, ast.Import):
                for alias in child.names:
                    if alias.name.startswith("spectra_kit."):
                        yield alias.name.removeprefix("spectra_kit.")
            yield from walk(child)

    return set(walk(ast.parse(source))) - {""}


GRAPH = {dotted(path): imports(path.read_text()) for path in FILES}


def test_rooms_import_what_lies_below() -> None:
    upward = [
        f"{module} imports {other}"
        for module, others in GRAPH.items()
        for other in others
        if (module, other) not in UPWARD
        and (room := other.split(".")[0]) != module.split(".")[0]
        and LEVEL[room] >= LEVEL[module.split(".")[0]]
    ]
    assert not upward


def test_no_circle_of_files() -> None:
    TopologicalSorter(GRAPH).prepare()
    with pytest.raises(CycleError):
        TopologicalSorter(GRAPH | {"errors": {"cli.entry"}}).prepare()


def test_nothing_else_is_imported_by_a_string() -> None:
    found = {
        path.relative_to(ROOT).as_posix()
        for path in FILES
        if any(word in path.read_text() for word in ("import_module", "__import__"))
    }
    assert found == BY_NAME


def test_the_front_door_is_for_the_command_line_alone() -> None:
    """What lies behind it cannot be seen here; the command line may use all rooms."""
    through = re.compile(r"^ *import spectra_kit( as \w+)?$", re.MULTILINE)
    rooms = {dotted(path).split(".")[0] for path in FILES if through.search(path.read_text())}
    assert rooms == {"cli"}


def test_the_check_sees_an_upward_import() -> None:
    assert imports("from spectra_kit.show import plot_modes") == {"show"}
    assert imports("def f():\n    from spectra_kit.neo import train") == {"neo.train"}


def test_arguments_are_checked_at_the_door_alone() -> None:
    """On what the reference lists, and on what those leave their arguments to."""
    pages = (ROOT.parent / "docs/api").glob("*.rst")
    listed = {name for page in pages for name in re.findall(r"\w+", page.read_text())}
    inside = [
        f"{dotted(path)}.{node.name}"
        for path in FILES
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.FunctionDef | ast.ClassDef)
        if "checked" in map(ast.unparse, node.decorator_list)
        if node.name not in listed and not node.name.startswith("_")
    ]
    assert set(inside) <= {"show.explorer.serve.serve"}  # which a command leaves its own to
