r"""Measure: `python apps/studies/run.py STUDY OUT`, and the options of the study.

    python apps/studies/run.py eigensolvers OUT --quick
    python apps/studies/run.py geodesics --help

OUT gets NAME.csv, a line for each measurement; NAME.md and NAME.json, tables of them; figures,
where the study draws some; and measurements.jsonl, which remembers each measurement as soon as it
ends: the same command after an interruption computes only what is missing. What was measured with
another code, other inputs or other options is measured again.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

if __name__ == "__main__":  # a script's own folder is on the path; the package lies beside it
    sys.path[0] = str(Path(__file__).parents[1])

from studies.command import exit_code, parser_of

#: Name -> module with `options`, which takes a parser, and `measure`, which takes its answer.
STUDIES = {
    "eigensolvers": "eigensolvers.command",
    "geodesics": "geodesics.command",
    "network": "network.command",
    "matching": "matching.command",
    "dense": "matching.dense",
    "collection": "matching.collection",
    "parts": "matching.parts",
    "carry": "matching.carry",
    "classification": "learning.classify",
    "segmentation": "learning.segment",
    "diffusion-net": "learning.diffusion_net",
    "ablation": "ablation",
    "batch": "batch.command",
    "many": "many",
    "device": "device",
    "explorer": "explorer",
    "walking": "walking",
    "yardstick": "yardstick",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Measure one study and report; return the exit code."""
    words = list(sys.argv[1:] if argv is None else argv)
    if not words or words[0] not in STUDIES:
        parser = parser_of("run.py", __doc__)
        parser.add_argument("study", choices=list(STUDIES), help="what to measure")
        parser.parse_args(words[:1])
    name, *rest = words
    study = import_module(f"studies.{STUDIES[name]}")
    parser = parser_of(f"run.py {name}", study.__doc__)
    parser.add_argument("out", type=Path, help="folder for everything")
    study.options(parser)
    args = parser.parse_args(rest)
    return exit_code(lambda: study.measure(args))


if __name__ == "__main__":
    sys.exit(main())
