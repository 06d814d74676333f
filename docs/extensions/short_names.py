"""Links from the short names in docstrings: `eigensolve` means the only public one of that name."""

from __future__ import annotations

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util.nodes import make_refnode


def resolve(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, content: nodes.TextElement
) -> nodes.reference | None:
    """Find what a Python reference that nothing else resolved ends with."""
    if node.get("refdomain") != "py":
        return None
    tail = "." + node["reftarget"].removeprefix("sk.").removesuffix("()")
    objects = env.domains["py"].data["objects"]
    found = [(name, entry) for name, entry in objects.items() if name.endswith(tail)]
    pages = {(entry.docname, entry.node_id) for _, entry in found}
    if len(pages) != 1:  # unknown, or several: text, not a link to a wrong place
        return None
    name, entry = found[0]
    return make_refnode(
        app.builder, node["refdoc"], entry.docname, entry.node_id, content, title=name
    )


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("missing-reference", resolve)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
