"""Several processes, one run: what they exchange, on torch.distributed.

Every process computes its share of each batch. Their gradients, some 20 MB, are added up once per
step in one message, so there is nothing to overlap and nothing to wrap.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor
from torch import distributed as dist


@dataclass(frozen=True)
class Ranks:
    """Number `rank` of `world` processes is this one; number 0 decides, validates, logs, saves."""

    rank: int = 0
    world: int = 1

    @classmethod
    def here(cls) -> Ranks:
        """Return those of the process group, or of a process on its own."""
        if dist.is_available() and dist.is_initialized():
            return cls(dist.get_rank(), dist.get_world_size())
        return cls()

    @property
    def first(self) -> bool:
        """Whether this is the process that decides."""
        return self.rank == 0

    def share(self, n: int) -> slice:
        """Return the places of a batch of n that are this process's."""
        return slice(self.rank * n // self.world, (self.rank + 1) * n // self.world)

    def add_up(self, tensors: Sequence[Tensor]) -> None:
        """Replace tensors by their sums over all processes."""
        if self.world == 1:
            return
        flat = torch.cat([tensor.flatten() for tensor in tensors])
        dist.all_reduce(flat)
        totals = torch.split(flat, [tensor.numel() for tensor in tensors])
        for tensor, total in zip(tensors, totals, strict=True):
            tensor.copy_(total.view_as(tensor))

    def agree(self, *values: float) -> tuple[float, ...]:
        """Return what process 0 passed."""
        if self.world == 1:
            return values
        shared = torch.tensor(values, dtype=torch.float64)
        dist.broadcast(shared, 0)
        return tuple(shared.tolist())


@contextmanager
def process_group(device: str) -> Iterator[str]:
    """Join the processes that ``torchrun`` started; yield the device of this one.

    That is `device` itself where the process is on its own. ``"cuda"`` gives each process of a
    machine its own accelerator, by its local rank.
    """
    if not dist.is_torchelastic_launched():
        yield device
        return
    if device == "cuda":
        device = f"cuda:{dist.get_node_local_rank()}"
        torch.cuda.set_device(device)
    # Decisions travel between CPUs, gradients between devices.
    dist.init_process_group("gloo" if device == "cpu" else "cpu:gloo,cuda:nccl")
    try:
        yield device
    finally:
        dist.destroy_process_group()
