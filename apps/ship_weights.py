"""Put trained weights into the package: the file, its line in the index, golden tensors."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save_file
from studies.command import exit_code, parser_of

from spectra_kit._core.files import atomic_path
from spectra_kit.eigen.subspaces.frame import canonical_frame
from spectra_kit.neo.pretrained import (
    INDEX,
    Shipped,
    load_pretrained,
    read_index,
    save_weights,
)

ROOT = Path(__file__).parents[1]
TOLD = ("steps", "samples", "minutes", "span_error", "mean")  # of the record, in the index


def ship(name: str, weights: Path, root: Path) -> str:
    """Ship `weights` as `name` in the source tree `root`, in float16; return the new hash."""
    loaded = load_pretrained(weights)
    file = f"neo-{name}.safetensors"
    path = root / "spectra_kit" / "neo" / "weights" / file
    digest = save_weights(path, loaded.network, loaded.record, dtype=torch.float16)
    told = {key: loaded.record[key] for key in TOLD if key in loaded.record}
    _register(path.parent, name, Shipped(file, digest, told))
    points, mass = _cloud()
    with torch.no_grad():
        basis = load_pretrained(path).network(points[None], mass[None])[0]
    with atomic_path(root / "tests" / "neo" / "golden" / file) as golden:
        save_file({"points": points, "mass": mass, "basis": basis}, golden)
    return digest


def _register(folder: Path, name: str, shipped: Shipped) -> None:
    """Write an entry of the index, in place of an old one of that name."""
    entries = read_index(folder) | {name: shipped}
    content = {key: entry._asdict() for key, entry in sorted(entries.items())}
    with atomic_path(folder / INDEX) as path:
        path.write_text(json.dumps(content, indent=1) + "\n")


def _cloud() -> tuple[torch.Tensor, torch.Tensor]:
    """A small cloud without symmetry, in its canonical frame."""
    rng = np.random.default_rng(0)
    points = rng.standard_normal((96, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    points *= (1 + 0.3 * np.sin(2 * points[:, :1])) * [3, 2, 1]
    mass = rng.uniform(0.5, 1.5, 96)
    posed = canonical_frame(points, mass).pose(points)
    return torch.from_numpy(posed).float(), torch.from_numpy(mass).float()


def main(argv: Sequence[str] | None = None) -> int:
    """Ship; return 0, or 2 where the file is no weights file."""
    parser = parser_of("ship_weights.py", __doc__)
    parser.add_argument("name", help="what users will call them, e.g. base")
    parser.add_argument("weights", type=Path, help="a .safetensors file of a training run or a leg")
    args = parser.parse_args(argv)

    def work() -> None:
        digest = ship(args.name, args.weights, ROOT)
        print(f"shipped {args.name} (sha256 {digest})")
        print("now run pytest tests/neo/test_neo_pretrained.py")

    return exit_code(work)


if __name__ == "__main__":
    raise SystemExit(main())
