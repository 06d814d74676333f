"""`code_digest`: which code was measured."""

from __future__ import annotations

import hashlib
from pathlib import Path

from spectra_kit._version import VERSION

_ROOT = Path(__file__).parents[1]
_PACKAGES = (
    "eigensolvers",
    "geodesics",
    "geometry",
    "levels",
    "linalg",
    "neo",
    "operators",
    "subspaces",
)
#: What operators, modes and distances are made of.
_SOURCES = tuple(f"{package}/**/*.py" for package in _PACKAGES)


def code_digest(root: Path = _ROOT, *, sources: tuple[str, ...] = _SOURCES) -> str:
    """Return the version of the package, and a hash of the sources of what is measured.

    Parameters
    ----------
    root : Path, optional
        Folder of the package.
    sources : tuple of str, optional
        Patterns of paths in it; by default what operators, modes and distances are made of.

    Returns
    -------
    str
        The same wherever the package lies.

    Examples
    --------
    >>> from spectra_kit.benchmarks.code import code_digest
    >>> code_digest() == code_digest()
    True
    """
    digest = hashlib.blake2b(digest_size=8)
    for pattern in sources:
        for path in sorted(root.glob(pattern)):
            digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return f"{VERSION}+{digest.hexdigest()}"
