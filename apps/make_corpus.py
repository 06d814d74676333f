"""Generate a training corpus: random surfaces with the exact modes of points on them.

Run it twice, with different seeds, for training and validation; run it again after an
interruption, and it continues.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from spectra_kit.errors import SpectraKitError
from spectra_kit.training.corpus import CorpusConfig, generate


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="make_corpus.py",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, help="where the shards go")
    parser.add_argument(
        "-n", "--samples", type=int, default=8192, help="samples in all (%(default)s)"
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="another one for validation (%(default)s)"
    )
    parser.add_argument("--points", type=int, default=2048, help="points per sample (%(default)s)")
    parser.add_argument(
        "-k", "--modes", type=int, default=96, help="modes per sample (%(default)s)"
    )
    parser.add_argument("--shard-size", type=int, default=128, help="samples a shard (%(default)s)")
    parser.add_argument("--workers", type=int, default=2, help="processes (%(default)s)")
    parser.add_argument(
        "--pool", type=Path, help="real meshes: a folder of chunks, or one packed file"
    )
    parser.add_argument(
        "--pool-share",
        type=float,
        help="fraction of samples from the pool (0.3 where there is one)",
    )
    parser.add_argument("--pool-split", default="train", help="split of the pool (%(default)s)")
    options = parser.parse_args(argv)
    share = options.pool_share
    if share is None:
        share = 0.0 if options.pool is None else 0.3
    try:
        config = CorpusConfig(
            seed=options.seed,
            n_points=options.points,
            k=options.modes,
            shard_size=options.shard_size,
            pool=options.pool,
            pool_share=share,
            pool_split=options.pool_split,
        )
        wall, cpu = time.perf_counter(), _cpu_seconds()
        with tqdm(unit="sample", disable=None) as bar:
            made = 0

            def progress(done: int, total: int) -> None:
                nonlocal made
                made, bar.total = done, total
                bar.update()
                if bar.disable and (done % config.shard_size == 0 or done == total):
                    print(f"{done} of {total} samples", flush=True)

            counts = generate(
                options.folder,
                options.samples,
                config=config,
                workers=options.workers,
                progress=progress,
            )
    except SpectraKitError as error:
        print(f"make_corpus: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"\nstopped; run the same command to continue {options.folder}", file=sys.stderr)
        return 130
    families = ", ".join(f"{name} {count}" for name, count in counts.families.items())
    rejected = ", ".join(f"{reason} {count}" for reason, count in counts.rejected.items())
    print(f"{counts.samples} samples in {options.folder}: {families}")
    print(f"drawn again because of: {rejected}")
    if made:
        wall, cpu = time.perf_counter() - wall, _cpu_seconds() - cpu
        print(f"{made} made in {wall:.0f} s: {made / wall:.2f} a second, {made / cpu:.2f} a core")
    return 0


def _cpu_seconds() -> float:
    """Time that this process and its ended children have computed."""
    usage = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(u.ru_utime + u.ru_stime for u in usage)


if __name__ == "__main__":
    sys.exit(main())
