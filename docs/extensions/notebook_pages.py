"""Notebooks as pages: the executed copies where the tests have left some, else the bare ones."""

from __future__ import annotations

import json
import os
import re
import shutil
from pathlib import Path

from sphinx.application import Sphinx

_NOTEBOOKS = Path(__file__).parents[2] / "notebooks"


def gather(source: Path, executed: Path | None, target: Path) -> None:
    """Copy each notebook of `source`, or its copy in `executed`, to `target`; changed ones only.

    Beside them goes a list of their questions, in ``questions.inc``.
    """
    target.mkdir(exist_ok=True)
    wanted = {path.name: path for path in sorted(source.glob("*.ipynb"))}
    for name in wanted:
        if executed is not None and (executed / name).is_file():
            wanted[name] = executed / name
    for stale in target.glob("*.ipynb"):
        if stale.name not in wanted:
            stale.unlink()
    for name, path in wanted.items():
        page = target / name
        if not page.is_file() or page.read_bytes() != path.read_bytes():
            shutil.copyfile(path, page)
    lines = [_entry(target.name, path) for path in wanted.values()]
    (target / "questions.inc").write_text("\n".join(lines) + "\n")


def _entry(folder: str, path: Path) -> str:
    """Return a line of the list: the title as a link, and the first question of the notebook."""
    first = "".join(json.loads(path.read_text())["cells"][0]["source"])
    title, _, text = first.partition("\n")
    question = re.search(r"[^.?!]*\?", " ".join(text.split()).replace("*", ""))
    title = title.removeprefix("# ")
    return f"- [{title}]({folder}/{path.name}): {question[0].strip() if question else ''}"


def setup(app: Sphinx) -> dict[str, bool]:
    executed = os.environ.get("SPECTRA_KIT_EXECUTED_NOTEBOOKS")
    gather(_NOTEBOOKS, Path(executed) if executed else None, Path(app.srcdir) / "notebooks")
    return {"parallel_read_safe": True, "parallel_write_safe": True}
