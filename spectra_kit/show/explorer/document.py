"""The HTML document: a template with style, program and data put in their places."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
from functools import cache
from importlib import resources
from typing import Any


def assembled(facts: dict[str, Any], blocks: dict[str, str]) -> str:
    """The template with everything in its place."""
    script = _asset("explorer.js").replace("</script", "<\\/script")
    digest = base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode("ascii")
    # Inside <script> only "<" could end the block; JSON may write it as an escape.
    record = json.dumps(facts, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    data = "\n".join(
        f'<script type="application/octet-stream" id="{name}">{text}</script>'
        for name, text in blocks.items()
    )
    content = {
        "TITLE": html.escape(facts["title"] or "Spectrum explorer"),
        "DIGEST": digest,
        "STYLE": _asset("explorer.css"),
        "FACTS": record,
        "DATA": data,
        "SCRIPT": script,
    }
    # One pass: what is put in is not searched again.
    return re.sub(r"%%([A-Z]+)%%", lambda m: content[m[1]], _asset("explorer.html"))


@cache
def _asset(name: str) -> str:
    return (resources.files("spectra_kit.show.explorer") / "assets" / name).read_text("utf-8")
