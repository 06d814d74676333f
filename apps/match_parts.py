r"""Match FAUST bodies without an arm, a leg or the lower half against other persons in other poses.

    python apps/match_parts.py OUT                        # 60 pairs of bodies 40-79
    python apps/match_parts.py OUT --persons 0 2 --pairs 9

OUT/measurements.jsonl gets a line for each pair as soon as it is matched, and the same command
after an interruption, by the same code, goes on from there. Errors are those of all landmarks that
both bodies have left, found covered or not, along edges of the uncut body, in hundredths of the
root of its area.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from measure.command import exit_code, parser_of
from measure.matching.cuts import (
    KINDS,
    REFERENCE,
    CutPair,
    cut_landmarks,
    cut_pairs,
    left_of,
    overlap,
    part_of,
)
from measure.matching.subjects import Subject, subjects_in
from measure.shapes import data_folder
from measure.store import Store, code_digest

from spectra_kit import prepare, spectrum
from spectra_kit.errors import DoubtfulMatchWarning, InvalidInputError
from spectra_kit.geodesics import pair_distances
from spectra_kit.maps import match_part

_MODES = 200


def main(argv: Sequence[str] | None = None) -> int:
    """Match and print the table; return the exit code."""
    parser = parser_of("match_parts.py", __doc__)
    parser.add_argument("out", type=Path, help="folder for measurements")
    parser.add_argument("--data", type=Path, help="default: $SPECTRA_KIT_DATA/faust_r")
    parser.add_argument("--persons", type=int, nargs="+", default=[4, 5, 6, 7], metavar="P")
    parser.add_argument("--pairs", type=int, default=60, metavar="N")
    parser.add_argument("--seed", type=int, default=0, help="of the draw (%(default)s)")
    args = parser.parse_args(argv)
    return exit_code(lambda: _match_all(args))


def _match_all(args: argparse.Namespace) -> None:
    folder = args.data or data_folder("faust_r")
    if folder is None:
        raise InvalidInputError("name a folder with --data, or set SPECTRA_KIT_DATA")
    subjects = subjects_in(folder)
    store = Store(args.out)
    rows = []
    for pair in cut_pairs(args.persons, args.pairs, seed=args.seed):
        key = f"{pair}, {code_digest()}"
        rows.append(store.get(key) or store.add(key, measure(subjects, pair)))
        print(rows[-1], flush=True)
    print(table(rows))


def measure(subjects: dict[str, Subject], pair: CutPair) -> dict[str, Any]:
    """Match a pair: mean error, overlap of what is covered, CPU seconds and doubts."""
    one, other = (subjects[f"tr_reg_{i:03d}"] for i in (pair.part, pair.whole))
    kept = cut_landmarks(subjects[REFERENCE], pair.kind, pair.seed)
    piece, left = part_of(one, kept), left_of(other, kept)
    part, whole = (prepare(spectrum(m, _MODES), m) for m in (piece.mesh, other.mesh))
    start = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DoubtfulMatchWarning)
        found = match_part(part, whole)
    seconds = time.process_time() - start
    both = kept & left[other.landmarks] & np.isin(one.landmarks, piece.vertices)
    places = piece.vertices[found.point_map[other.landmarks[both]]]
    errors = pair_distances(one.mesh, one.landmarks[both], places)
    return {
        "status": "ok",
        "pair": str(pair),
        "kind": pair.kind,
        "error": 100 * float(errors.mean()) / one.mesh.area**0.5,
        "overlap": overlap(np.asarray(found.covered), left, whole.spectrum.mass),
        "margin": found.margin,
        "score": found.score,
        "doubts": list(found.doubts),
        "cpu_seconds": seconds,
    }


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Return median, mean and worst of errors and overlaps, for each kind and for all."""
    out = [f"{'cut':<6}{'pairs':>6}{'error: median, mean, worst':>30}{'overlap: the same':>26}"]
    for kind in (*KINDS, "all"):
        some = [row for row in rows if kind in (row["kind"], "all")]
        if some:
            e, o = (np.array([row[name] for row in some]) for name in ("error", "overlap"))
            errors = f"{np.median(e):.2f}, {e.mean():.2f}, {e.max():.2f}"
            overlaps = f"{np.median(o):.3f}, {o.mean():.3f}, {o.min():.3f}"
            out.append(f"{kind:<6}{len(some):>6}{errors:>30}{overlaps:>26}")
    return "\n".join(out)


if __name__ == "__main__":
    sys.exit(main())
