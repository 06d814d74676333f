"""Links from the short names in docstrings: `eigensolve` means the only public one of that name."""

from __future__ import annotations

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util.nodes import make_refnode

import spectra_kit

_KINDS = ("class", "exception", "function", "data")


def resolve(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, content: nodes.TextElement
) -> nodes.reference | None:
    """Find what a Python reference that nothing else resolved ends with."""
    if node.get("refdomain") != "py":
        return None
    target = node["reftarget"].removeprefix("sk.")
    # A word alone is more often an argument: `count`, `geometry`, `laplacian`.
    word = target.isalpha() and target.islower()
    if word and not callable(getattr(spectra_kit, target, None)):
        return None
    kinds = (*_KINDS, "method", "property", "attribute") if "." in target else _KINDS
    found = {
        (entry.docname, entry.node_id): name
        for name, entry in env.domains["py"].data["objects"].items()
        if name.endswith("." + target) and entry.objtype in kinds
    }
    if len(found) != 1:  # unknown, or several: text, not a link to a wrong place
        return None
    [((page, place), name)] = found.items()
    return make_refnode(app.builder, node["refdoc"], page, place, content, title=name)


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("missing-reference", resolve)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
