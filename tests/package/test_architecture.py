"""Imports point down the table of layers, and the package is quick to import."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[2] / "spectra_kit"
LAYERS = [
    "_types",
    "errors _clock _version catalogue",
    "_files _optional _fingerprint",
    "_arrays_file",
    "_display",
    "_validate _checked",
    "geometry linalg",
    "operators",
    "_spectrum_file subspaces levels",
    "spectra neo",
    "eigensolvers metrics descriptors functional_maps geodesics",
    "correspondence differentiable embeddings store interop",
    "matching",
    "training viz",
    "learning",
    "explorer batch",
    "cli",
    "__main__",
]
LEVEL = {name: i for i, row in enumerate(LAYERS) for name in row.split()}
# `metrics` never sees a solver.
FILES = sorted(p for p in ROOT.rglob("*.py") if p != ROOT / "__init__.py")


def unit(path: Path) -> str:
    return path.relative_to(ROOT).with_suffix("").parts[0]


def imported_units(source: str) -> set[str]:
    """Units of spectra_kit that `source` imports, those for type checkers alone left out."""

    def walk(node: ast.AST):
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.If) and ast.unparse(child.test) == "TYPE_CHECKING":
                continue
            if isinstance(child, ast.ImportFrom) and (child.module or "").startswith("spectra_kit"):
                tail = (child.module or "").split(".")[1:]
                yield from tail[:1] or (alias.name for alias in child.names)
            if isinstance(child, ast.Import):
                for alias in child.names:
                    if alias.name.startswith("spectra_kit."):
                        yield alias.name.split(".")[1]
            yield from walk(child)

    return set(walk(ast.parse(source)))


def test_imports_point_down() -> None:
    upward = [
        f"{path.relative_to(ROOT)} imports {other}"
        for path in FILES
        for other in imported_units(path.read_text()) - {unit(path)}
        if LEVEL[other] >= LEVEL[unit(path)]
    ]
    assert not upward


def test_the_check_sees_an_upward_import() -> None:
    assert imported_units("from spectra_kit.viz import plot_modes") == {"viz"}
    assert imported_units("def f():\n    from spectra_kit import training") == {"training"}
