"""Generate a training corpus: random surfaces with the exact modes of points on them.

Run it twice, with different seeds, for training and validation; run it again after an
interruption, and it continues.
"""

from __future__ import annotations

import resource
import sys
import time
from argparse import Namespace, _ActionsContainer
from collections.abc import Sequence
from pathlib import Path

from studies.command import exit_code, parser_of
from tqdm import tqdm

from spectra_kit.neo.train.corpus import generate
from spectra_kit.neo.train.samples import CorpusConfig


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    parser = parser_of("make_corpus.py", __doc__)
    add = parser.add_argument
    add("folder", type=Path, help="where the shards go")
    add("-n", "--samples", type=int, default=8192, help="samples in all (%(default)s)")
    add("--seed", type=int, default=0, help="another one for validation (%(default)s)")
    add("--workers", type=int, default=2, help="processes (%(default)s)")
    add_corpus_options(parser)
    options = parser.parse_args(argv)
    return exit_code(lambda: _make(options))


def add_corpus_options(parser: _ActionsContainer) -> None:
    """Add what samples are made of, but for the seed."""
    add = parser.add_argument
    add("--points", type=int, default=1024, help="points per sample (%(default)s)")
    add("-k", "--modes", type=int, default=96, help="modes per sample (%(default)s)")
    add("--shard-size", type=int, default=128, help="samples a shard (%(default)s)")
    add("--mesh-share", type=float, default=0.0, help="fraction of meshes (%(default)s)")
    add("--pool", type=Path, help="real meshes: a folder of chunks, or one packed file")
    share = "fraction of samples from the pool (0.3 where there is one)"
    add("--pool-share", type=float, help=share)
    add("--pool-split", default="train", help="split of the pool (%(default)s)")
    family = "weight of a family, such as tube=12; may come several times"
    add("--family", action="append", default=[], type=_weight, help=family)


def _weight(text: str) -> tuple[str, float]:
    name, _, weight = text.partition("=")
    return name, float(weight)


def corpus_config(options: Namespace) -> CorpusConfig:
    """Return what these options and the seed say."""
    share = 0.0 if options.pool is None else 0.3
    return CorpusConfig(
        seed=options.seed,
        n_points=options.points,
        k=options.modes,
        shard_size=options.shard_size,
        mesh_share=options.mesh_share,
        pool=options.pool,
        pool_share=share if options.pool_share is None else options.pool_share,
        pool_split=options.pool_split,
        weights=dict(options.family),
    )


def _make(options: Namespace) -> None:
    config = corpus_config(options)
    wall, cpu = time.perf_counter(), _cpu_seconds()
    with tqdm(unit="sample", disable=None) as bar:

        def progress(done: int, total: int) -> None:
            bar.total, bar.n = total, done
            bar.update(0)
            if bar.disable and (done % config.shard_size == 0 or done == total):
                print(f"{done} of {total} samples", flush=True)

        workers = options.workers
        counts = generate(
            options.folder, options.samples, config=config, workers=workers, progress=progress
        )
        made = bar.n
    families = ", ".join(f"{name} {count}" for name, count in counts.families.items())
    rejected = ", ".join(f"{reason} {count}" for reason, count in counts.rejected.items())
    print(f"{counts.samples} samples in {options.folder}: {families}")
    print(f"drawn again because of: {rejected}")
    if made:
        wall, cpu = time.perf_counter() - wall, _cpu_seconds() - cpu
        print(f"{made} made in {wall:.0f} s: {made / wall:.2f} a second, {made / cpu:.2f} a core")


def _cpu_seconds() -> float:
    """Time that this process and its ended children have computed."""
    usage = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(u.ru_utime + u.ru_stime for u in usage)


if __name__ == "__main__":
    sys.exit(main())
