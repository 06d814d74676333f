"""Every notebook is committed without outputs, and reads like a lecture.

They are executed when the pages are built, where each must show a picture and complain of nothing.
"""

import re
import shutil
import subprocess
from pathlib import Path

import nbformat
import pytest

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
each_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def read(path: Path) -> nbformat.NotebookNode:
    return nbformat.read(path, as_version=nbformat.NO_CONVERT)


@each_notebook
def test_notebook_is_clean_and_reads_like_a_lecture(path: Path) -> None:
    notebook = read(path)
    nbformat.validate(notebook)
    first, *rest = notebook.cells
    code = [cell for cell in rest if cell.cell_type == "code"]
    assert all(not cell.outputs and cell.execution_count is None for cell in code)
    assert notebook.metadata == {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    assert not re.search(r"/(home|root|work|tmp|Users)/", path.read_text())
    assert first.source.startswith("# ")
    assert "?" in first.source  # the question that it answers
    assert len(rest) - len(code) >= len(code) / 2
    assert max(cell.source.count("\n") for cell in rest) < 25


def test_git_ignores_what_notebooks_write(tmp_path: Path) -> None:
    git = shutil.which("git") or pytest.skip("git is not installed")
    shutil.copy(NOTEBOOKS[0].parents[1] / ".gitignore", tmp_path)
    folder = tmp_path / "notebooks"
    folder.mkdir()
    code = "".join(c.source for path in NOTEBOOKS for c in read(path).cells)
    written = re.findall(r'"([\w.]+\.(?:png|gif|npz|html|safetensors))"', code)
    assert len(written) > 4
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
