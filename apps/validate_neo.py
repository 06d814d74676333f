r"""Tell how far off `Neo` is on the samples of a corpus, kind by kind, and where most.

The corpus should be as shapes are that users bring, and not of the training samples:

    python apps/make_corpus.py corpus/full -n 48 --seed 2000003 --points 8192 --mesh-share 0.5 \
        --shard-size 8 --pool DATA/train_pool --pool-share 0.5 --pool-split val
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from studies.command import exit_code, parser_of

from spectra_kit.eigen import Cascade, Neo
from spectra_kit.eigen.subspaces import AmbientFourier
from spectra_kit.neo.train.corpus import open_shards
from spectra_kit.neo.train.evaluation import errors_of, kinds, typical

_MEANS = {"predicted": typical, "span": typical, "value": typical, "steps": np.mean}
_BANDWIDTH = 7.0  # of the best of a few hundred plane waves, and of a network's


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    parser = parser_of("validate_neo.py", __doc__)
    add = parser.add_argument
    add("corpus", type=Path, help="folder of shards with operators")
    add("--weights", default="small", help="a name or a file (%(default)s)")
    add("--fourier", type=int, help="so many plane waves in place of a network, smoothed alike")
    add("--smoothing", type=int, default=Neo().max_steps, help="steps of Neo (%(default)s)")
    add("--most", type=int, help="only so many samples, the first ones")
    add("--worst", type=int, default=10, help="samples to name (%(default)s)")
    options = parser.parse_args(argv)
    return exit_code(lambda: _validate(options))


def _validate(options: Namespace) -> None:
    corpus = open_shards(options.corpus)
    solver: Neo | Cascade = Neo(weights=options.weights, max_steps=options.smoothing)
    if options.fourier is not None:
        waves = AmbientFourier(m=options.fourier, bandwidth=_BANDWIDTH)
        solver = Cascade(subspace=waves, coarsest=sys.maxsize, max_steps=options.smoothing)
    errors = errors_of(solver, corpus, most=options.most)
    count = len(errors["span"])
    labels = {name: label[:count] for name, label in corpus.labels.items()}
    kind = kinds(labels)
    width = max(map(len, kind))
    print(f"{'':{width}s} samples  " + " ".join(f"{name:>10s}" for name in _MEANS))
    forms = np.array([name.partition(" ")[0] for name in kind])
    groups = [(f"every {form}", forms == form) for form in sorted(set(forms))]
    groups += [(name, kind == name) for name in sorted(set(kind))]
    for name, chosen in groups:
        means = (mean(errors[name][chosen]) for name, mean in _MEANS.items())
        print(f"{name:{width}s} {chosen.sum():7d}  " + " ".join(f"{mean:10.2e}" for mean in means))
    print("errors: geometric means")
    print("\nthe worst after smoothing, by index")
    for i in np.argsort(-errors["span"])[: options.worst]:
        row = " ".join(f"{part[i]:10.2e}" for part in errors.values())
        print(f"{kind[i]:{width}s} {labels['index'][i]:7d}  {row}  {labels['n'][i]} points")


if __name__ == "__main__":
    sys.exit(main())
