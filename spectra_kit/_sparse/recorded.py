"""What is launched on a CUDA device, recorded at first and from then on launched at once.

Thousands of small launches take longer than their work; and each waits for the interpreter, which
other threads hold.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import cache, lru_cache
from typing import Any, NamedTuple

import torch
from torch import Tensor

_lock = threading.Lock()  # a recording has one set of arguments and results


class _Recording(NamedTuple):
    graph: torch.cuda.CUDAGraph
    given: list[Tensor]
    found: tuple[Tensor, ...]


def recorded(function: Callable[..., tuple[Tensor, ...]], *given: Any) -> tuple[Tensor, ...]:
    """Return what a function makes of tensors and numbers, anew for each kind of them.

    It does the same whatever they hold, reads nothing of them, and is of a module. On other devices
    than CUDA it is called.
    """
    if given[0].device.type != "cuda":
        return function(*given)
    tensors = [x for x in given if isinstance(x, Tensor)]
    kinds = ((x.shape, x.dtype) if isinstance(x, Tensor) else x for x in given)
    with _lock, torch.cuda.device(given[0].device):
        recording = _recording(function, given[0].device, *kinds)
        for own, x in zip(recording.given, tensors, strict=True):
            own.copy_(x)
        recording.graph.replay()
        return tuple(x.clone() for x in recording.found)


@lru_cache(maxsize=8)
def _recording(
    function: Callable[..., tuple[Tensor, ...]], device: torch.device, *kinds: Any
) -> _Recording:
    arguments = [
        torch.ones(x[0], dtype=x[1], device=device) if isinstance(x, tuple) else x for x in kinds
    ]
    beside = torch.cuda.Stream(device)  # type: ignore[no-untyped-call]
    beside.wait_stream(torch.cuda.current_stream(device))
    with torch.cuda.stream(beside):  # libraries take what they need at the first call
        function(*arguments)
    torch.cuda.current_stream(device).wait_stream(beside)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph, pool=_pool(device), capture_error_mode="thread_local"):
        found = function(*arguments)
    return _Recording(graph, [x for x in arguments if isinstance(x, Tensor)], found)


@cache
def _pool(device: torch.device) -> Any:
    """Return memory that all recordings share, of which one is at work at a time."""
    return torch.cuda.graph_pool_handle()
