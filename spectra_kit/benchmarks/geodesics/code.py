"""`code_digest`: which code was measured."""

from __future__ import annotations

import hashlib
from importlib.metadata import version
from pathlib import Path

_ROOT = Path(__file__).parents[2]
#: What distances are made of.
_PACKAGES = ("geodesics", "linalg", "operators")


def code_digest(root: Path = _ROOT) -> str:
    """Return the version of the package, and a hash of the sources that distances are made of.

    Parameters
    ----------
    root : Path, optional
        Folder of the package.

    Returns
    -------
    str
        The same wherever the package lies.

    Examples
    --------
    >>> code_digest() == code_digest()
    True
    """
    digest = hashlib.blake2b(digest_size=8)
    for package in _PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return f"{version('spectra_kit')}+{digest.hexdigest()}"
