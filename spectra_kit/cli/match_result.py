"""What a match writes, of wholes and of parts: names of files, doubts in words, how it is drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import spectra_kit as sk
from spectra_kit.cli.words import stem

if TYPE_CHECKING:
    from spectra_kit.cli.match import MatchOptions
    from spectra_kit.geometry import Geometry

MAP, PARTS = "point_map.npy", "components.csv"
PICTURES = ("correspondence.png", "functional_map.png", "errors.png")


def doubts_of(found: sk.Match) -> str:
    """Say what speaks against a match; nothing if nothing does."""
    other = "does not mirror" if found.mirrored else "mirrors"
    told = {
        "margin": "another map scores as well",
        "mirror_margin": f"one that {other} scores better",
        "alike": "the surfaces are so round that others look as good",
        "orientation": "its orientation is not that of a whole map",
        "consistent": "it is in doubt which side of a cloud is out",
        "coverage": "it covers hardly more of the source than chance would",
        "score": "the surfaces look no more alike than unrelated ones",
        "discontinuity": "it takes neighbours apart",
        "genera": "the surfaces have other numbers of handles",
        "rims": "at least one is cut off, and not where the other is",
        "landmark_distances": "it does not lead to all landmarks",
        "initial": "it follows from the map that was given, and no other was tried",
        "unconnected": "no convincing pairs of the collection connect the two",
    }
    return ", ".join(told[name] for name in found.doubts)


def setting(asked: MatchOptions, source: Geometry, target: Geometry) -> dict[str, Any]:
    """Return how a map is drawn: from where, and what is written beside it."""
    names = (stem(asked.source), stem(asked.target))
    size = f"{source.n:,} and {target.n:,} points"
    return {
        "view": asked.view,
        "names": names if names[0] != names[1] else ("source", "target"),
        "page": sk.show.Page(" to ".join(names), size, asked.dpi),
    }
