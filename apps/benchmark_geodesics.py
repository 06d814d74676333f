"""Measure distance solvers side by side: iterations, seconds, errors against exact distances.

    python apps/benchmark_geodesics.py OUT                        # needs SPECTRA_KIT_DATA
    python apps/benchmark_geodesics.py OUT --meshes igea amo      # of SPECTRA_KIT_DATA/ood_public
    python apps/benchmark_geodesics.py OUT --meshes my.obj --sources 50

OUT gets NAME.json for each mesh, sphere.json and report.md. A mesh is not measured again on the
same machine with the same settings and code: delete its file for that. Exact distances, which take
longest, are kept apart in OUT/exact, and serve until the code changes that computes them. Nothing
else should run on the machine meanwhile.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from spectra_kit._files import atomic_path, parsing
from spectra_kit.benchmarks.code import code_digest
from spectra_kit.benchmarks.geodesics import (
    Settings,
    measure_ball,
    measure_mesh,
    problems_named,
    write_geodesic_report,
)
from spectra_kit.errors import SpectraKitError

DEFAULTS = Settings()
MESHES = ("hammer", "bunny", "horse", "koala", "amo", "igea")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="benchmark_geodesics.py",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("out", type=Path, help="folder for everything")
    add("--meshes", nargs="+", default=list(MESHES), metavar="FILE|NAME",
        help=f"default: {' '.join(MESHES)}")  # fmt: skip
    add("--sources", type=int, default=DEFAULTS.sources,
        help="for the time of many (%(default)s)")  # fmt: skip
    add("--exact-sources", type=int, default=DEFAULTS.exact_sources,
        help=f"where errors are measured; two on more than {DEFAULTS.large:,} vertices"
        " (%(default)s)")  # fmt: skip
    add("--repeats", type=int, default=DEFAULTS.repeats, help="of each clocked run (%(default)s)")
    add("--threads", type=int, default=os.cpu_count() or 1,
        help="for all alike (default: all cores)")  # fmt: skip
    add("--seed", type=int, default=DEFAULTS.seed, help="of the sources (%(default)s)")
    add("--sphere", type=int, nargs="+", default=[3, 4, 5, 6], metavar="N",
        help="subdivisions of the spheres (default: 3 4 5 6)")  # fmt: skip
    add("--warm", type=int, default=DEFAULTS.warm, metavar="N",
        help="subdivisions of the sphere that each process warms up on (%(default)s)")  # fmt: skip
    add("--quick", action="store_true",
        help="everything in one process, for a look: seconds are not comparable")  # fmt: skip
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, write the report, print it; return the exit code."""
    args = _parser().parse_args(argv)
    names = {field.name for field in dataclasses.fields(Settings)}
    try:
        settings = Settings(**{k: v for k, v in vars(args).items() if k in names})
        models = problems_named(args.meshes)
        args.out.mkdir(parents=True, exist_ok=True)
        records = [measure_mesh(model, settings, args.out, say=_say) for model in models]
        ball = _ball(args.sphere, args.out / "sphere.json")
        print(write_geodesic_report(records, ball, args.out / "report.md"))
    except SpectraKitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"\nstopped; run the same command to continue {args.out}", file=sys.stderr)
        return 130
    return 0


def _ball(subdivisions: list[int], path: Path) -> dict[str, object]:
    """Measure errors on spheres, or read what the same code measured."""
    code = code_digest()
    if path.exists():
        with parsing(path, "measurement", remedy="delete it"):
            known: dict[str, object] = dict(json.loads(path.read_text()))
        if known.get("code") == code and known["subdivisions"] == subdivisions:
            return known
    _say("spheres")
    record = {"code": code, "subdivisions": subdivisions, **measure_ball(subdivisions)}
    with atomic_path(path) as part:
        part.write_text(json.dumps(record, indent=1))
    return record


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
