"""What the library says of its functions and arguments, in the words of the command line."""

from __future__ import annotations

import os
import re
from pathlib import Path

_OPTIONS = {
    "k": "-k",
    "n_points": "--points",
    "modes": "--modes",
    "rtol": "--rtol",
    "seed": "--seed",
    "dpi": "--dpi",
    "turn": "--turn",
    "name_or_path": "--weights",
    "coordinate": "--at",
}
# Longest first; the advice of two methods that are one option is given once.
_ADVICE = (
    (r", or join the corners of a mesh with `mesh\.with_merged_vertices\(\)`", ""),
    (r"`?(mesh|cloud)\.(without_\w+|with_merged_vertices)\(\)`?", "--repair"),
    (r"\bdrop them with --repair", "--repair drops them"),
    (r"\bdrop such vertices with --repair", "--repair drops such vertices"),
    (r"\buse robust_laplacian\b", "use --operator robust, the default for spectra"),
    (r"\buse delaunay_laplacian\b", "use --operator delaunay"),
    (r"\buse Arpack\b", "use --solver arpack"),
    (r"\bloosen `rtol`", "loosen --rtol"),
    (r"\bgive `landmarks`, or try another `k`", "give --landmarks, or try another -k"),
    (
        r"\btake Polished or Refined .* such as Arpack\(\)",
        "take --solver polished or refined, or an exact one such as --solver arpack",
    ),
)


def stem(file: str) -> str:
    r"""Return the name of a file for a title: no folder, no ending, bytes of no text as such.

    Examples
    --------
    >>> from spectra_kit.cli.words import stem
    >>> print(stem("cats/b\udcffb.off"))
    b\xffb
    """
    return os.fsencode(Path(file).stem).decode(errors="backslashreplace")


def in_options(message: str) -> str:
    """Return a message of the library with options in place of arguments and methods.

    Parameters
    ----------
    message : str
        Of an error, a warning, or of `Diagnosis.problems`.

    Returns
    -------
    str
        The same for somebody who types commands.

    Examples
    --------
    >>> from spectra_kit.cli.words import in_options
    >>> in_options("`k` must be at least 1, got 0")
    '`-k` must be at least 1, got 0'
    >>> in_options("2 vertices have no face: mesh.without_unreferenced()")
    '2 vertices have no face: --repair'
    """
    for pattern, words in _ADVICE:
        message = re.sub(pattern, words, message)
    return re.sub(
        r"^`(\w+)`(?= must )", lambda found: f"`{_OPTIONS.get(found[1], found[1])}`", message
    )
