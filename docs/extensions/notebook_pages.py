"""Notebooks as pages, and what is asked of them: each shows a picture and complains of nothing.

Their questions stand in ``docs/notebooks.md``, with links to the notebooks themselves, as the
repository shows it; the build brings the list up to date, and links to their pages.

They are executed while the pages are built; a cell that fails, or writes to stderr, is a warning
(``nb_output_stderr`` in ``conf.py``), which ``sphinx-build -W`` does not forgive.
"""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util import logging

_NOTEBOOKS = Path(__file__).parents[2] / "notebooks"
PAGE = Path(__file__).parents[1] / "notebooks.md"
BEGIN = "<!-- written by docs/extensions/notebook_pages.py -->\n"
_IN_REPOSITORY = "../notebooks/"
_log = logging.getLogger(__name__)


def gather(source: Path, target: Path) -> None:
    """Copy each notebook of `source` to `target` if it has changed."""
    target.mkdir(exist_ok=True)
    wanted = sorted(source.glob("*.ipynb"))
    for stale in {*target.glob("*.ipynb")} - {target / path.name for path in wanted}:
        stale.unlink()
    for path in wanted:
        page = target / path.name
        if not page.is_file() or page.read_bytes() != path.read_bytes():
            shutil.copyfile(path, page)


def listed(page: str, source: Path) -> str:
    """Return a page with the questions of all notebooks of `source` at its end."""
    entries = [_entry(_IN_REPOSITORY, path) for path in sorted(source.glob("*.ipynb"))]
    return page.partition(BEGIN)[0] + BEGIN + "\n" + "\n".join(entries) + "\n"


def _entry(folder: str, path: Path) -> str:
    """Return a line of the list: the title as a link, and the first question of the notebook."""
    first = "".join(json.loads(path.read_text())["cells"][0]["source"])
    title, _, text = first.partition("\n")
    question = re.search(r"[^.?!]*\?", " ".join(text.split()).replace("*", ""))
    title = title.removeprefix("# ")
    return f"- [{title}]({folder}{path.name}): {question[0].strip() if question else ''}"


def _link_to_pages(app: Sphinx, page: str, source: list[str]) -> None:
    if page == "notebooks":
        source[0] = source[0].replace(f"]({_IN_REPOSITORY}", "](notebooks/")


def _make_cache(app: Sphinx, env: BuildEnvironment, pages: list[str]) -> None:
    """Make the database of executed notebooks: two processes that begin with it would clash."""
    from jupyter_cache import get_cache  # comes with myst_nb, which tests do without

    path = Path(env.mystnb_config.execution_cache_path)  # type: ignore[attr-defined]  # of myst_nb
    path.mkdir(parents=True, exist_ok=True)
    get_cache(str(path)).db.dispose()


def _spread(app: Sphinx, env: BuildEnvironment, pages: list[str]) -> None:
    """Reorder pages that are to be read: notebooks apart, as a process is given many in a row."""
    slow = [page for page in pages if page.startswith("notebooks/")]
    pages[:] = [page for page in pages if page not in slow]
    for i, page in enumerate(slow):
        pages.insert(i * len(pages) // len(slow), page)


def _ask_for_a_picture(app: Sphinx, doctree: nodes.document) -> None:
    page = app.env.docname
    if page.startswith("notebooks/") and not any(doctree.findall(nodes.image)):
        _log.warning("no cell of this notebook shows a picture", location=page)


def setup(app: Sphinx) -> dict[str, bool]:
    gather(_NOTEBOOKS, Path(app.srcdir) / "notebooks")
    before = PAGE.read_text()
    if (now := listed(before, _NOTEBOOKS)) != before:
        PAGE.write_text(now)
    app.connect("source-read", _link_to_pages)
    app.connect("env-before-read-docs", _make_cache)
    app.connect("env-before-read-docs", _spread)
    app.connect("doctree-read", _ask_for_a_picture)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
