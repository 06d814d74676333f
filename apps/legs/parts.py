"""Checkpoints that travel: small, and in parts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from torch import Tensor
from torch.utils._pytree import tree_map_only

from spectra_kit._core.files import atomic_path
from spectra_kit.errors import InvalidInputError
from spectra_kit.neo.train.checkpoint import NAME, packed, unpacked

_PARTS = "checkpoint.[0-9][0-9]of[0-9][0-9]"


def write_parts(folder: Path, content: dict[str, Any], *, limit: int = 15 * 2**20) -> None:
    """Write a checkpoint small, as ``checkpoint.01of03`` and so on, of at most `limit` bytes each.

    A run goes on from there well, but not bit by bit: the averaged weights alone are kept, as
    float16, which is as exact as the shipped files; Muon's momentum, an average over some twenty
    steps, begins anew; AdamW's averages are kept as bfloat16, for they may be smaller than
    float16 goes. Parts of an earlier checkpoint are removed.
    """
    weights = content["average"] or content["network"]
    small = {
        **content,
        "network": tree_map_only(Tensor, Tensor.half, weights),
        "average": {},
        "optimizers": [_without_momentum(saved) for saved in content["optimizers"]],
    }
    data = packed(small)
    for old in folder.glob(_PARTS):
        old.unlink()
    total = -(-len(data) // limit)
    for number in range(total):
        with atomic_path(folder / f"checkpoint.{number + 1:02d}of{total:02d}") as path:
            path.write_bytes(data[number * limit : (number + 1) * limit])


def read_parts(folder: Path) -> dict[str, Any]:
    """Return what `write_parts` wrote, in float32, the average in place of the weights too."""
    paths = sorted(folder.glob(_PARTS))
    total = int(paths[0].name[-2:]) if paths else 1
    if len(paths) != total:
        raise InvalidInputError(
            f"all {total} parts of the checkpoint must be in {folder}, found {len(paths)}",
            advice="copy the rest there, and nothing older",
        )
    data = b"".join(path.read_bytes() for path in paths)
    content = unpacked(data, folder / NAME, "copy all its parts there again")
    whole: dict[str, Any] = tree_map_only(Tensor, _restored, content)
    return {**whole, "average": whole["network"]}


def _restored(tensor: Tensor) -> Tensor:
    return tensor.float() if tensor.is_floating_point() else tensor


def _halved(tensor: Tensor) -> Tensor:
    return tensor.bfloat16() if tensor.ndim else tensor  # counts of steps stay exact


def _without_momentum(saved: dict[str, Any]) -> dict[str, Any]:
    kept = {
        index: tree_map_only(Tensor, _halved, averages)
        for index, averages in saved["state"].items()
        if "momentum_buffer" not in averages
    }
    return {**saved, "state": kept}
