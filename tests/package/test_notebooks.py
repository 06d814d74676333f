"""Every notebook runs from top to bottom in a kernel of its own, and is committed without outputs.

Set ``SPECTRA_KIT_EXECUTED_NOTEBOOKS`` to a folder to keep the executed copies.
"""

import os
import re
import shutil
import subprocess
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
TIMEOUT = 180  # seconds of one cell
# Before the first cell, and unseen: what warns there, fails there.
# (ipykernel warns of its own ways when it shuts down.)
STRICT = (
    "--IPKernelApp.exec_lines=import warnings; warnings.simplefilter('error');"
    " warnings.filterwarnings('default', module='ipykernel')"
)

each_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def read(path: Path) -> nbformat.NotebookNode:
    return nbformat.read(path, as_version=nbformat.NO_CONVERT)


def outputs(notebook: nbformat.NotebookNode) -> list[nbformat.NotebookNode]:
    return [out for cell in notebook.cells if cell.cell_type == "code" for out in cell.outputs]


@pytest.mark.slow
@each_notebook
def test_notebook_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("IPYTHONDIR", "JUPYTER_CONFIG_DIR", "JUPYTER_RUNTIME_DIR"):
        monkeypatch.setenv(name, str(tmp_path / name.lower()))  # nobody's own settings
    folder = tmp_path / "work"
    folder.mkdir()
    notebook = read(path)
    client = NotebookClient(
        notebook,
        timeout=TIMEOUT,
        extra_arguments=[STRICT],
        resources={"metadata": {"path": str(folder)}},
    )
    client.execute()
    if keep := os.environ.get("SPECTRA_KIT_EXECUTED_NOTEBOOKS"):
        Path(keep).mkdir(parents=True, exist_ok=True)
        nbformat.write(notebook, Path(keep) / path.name)
    complaints = [out.text for out in outputs(notebook) if out.get("name") == "stderr"]
    assert not complaints
    assert any("image/png" in out.get("data", {}) for out in outputs(notebook))


@each_notebook
def test_notebook_is_clean(path: Path) -> None:
    notebook = read(path)
    nbformat.validate(notebook)
    assert not outputs(notebook)
    assert all(c.execution_count is None for c in notebook.cells if c.cell_type == "code")
    assert notebook.metadata == {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    assert not re.search(r"/(home|root|work|tmp|Users)/", path.read_text())


@each_notebook
def test_notebook_reads_like_a_lecture(path: Path) -> None:
    first, *rest = read(path).cells
    assert first.cell_type == "markdown"
    assert first.source.startswith("# ")
    assert "?" in first.source  # the question that it answers
    kinds = [cell.cell_type for cell in rest]
    assert kinds.count("markdown") >= kinds.count("code") / 2
    assert max(cell.source.count("\n") for cell in rest) < 25


def test_git_ignores_what_notebooks_write(tmp_path: Path) -> None:
    git = shutil.which("git") or pytest.skip("git is not installed")
    shutil.copy(NOTEBOOKS[0].parents[1] / ".gitignore", tmp_path)
    folder = tmp_path / "notebooks"
    folder.mkdir()
    code = "".join(c.source for path in NOTEBOOKS for c in read(path).cells)
    written = re.findall(r'"([\w.]+\.(?:png|gif|npz|html|safetensors))"', code)
    assert len(written) > 9
    for name in (*written, "another.ipynb"):
        (folder / name).touch()
    subprocess.run([git, "init", "-q", str(tmp_path)], check=True)
    status = subprocess.run(
        [git, "-C", str(tmp_path), "status", "--porcelain", "-uall"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "?? notebooks/another.ipynb" in status.stdout
    assert status.stdout.count("notebooks/") == 1


def test_the_course_is_complete() -> None:
    assert [path.stem[:2] for path in NOTEBOOKS] == [f"{i:02d}" for i in range(1, 8)]
