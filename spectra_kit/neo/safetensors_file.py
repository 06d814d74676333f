"""The safetensors format: a length, a JSON header, and the bytes of the tensors.

The library of that name does the same; training must run where it is not installed, and two
readers of one format would be one too many. A test exchanges files with it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from spectra_kit.errors import WeightsError

_DTYPES = {
    "F64": torch.float64,
    "F32": torch.float32,
    "F16": torch.float16,
    "BF16": torch.bfloat16,
    "I64": torch.int64,
    "I32": torch.int32,
    "U8": torch.uint8,
    "BOOL": torch.bool,
}
_NAMES = {dtype: name for name, dtype in _DTYPES.items()}


def pack(tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> bytes:
    """Return the content of a file with these tensors; equal arguments give equal bytes.

    Examples
    --------
    >>> tensors, metadata = unpack(pack({"a": torch.ones(2)}, {"unit": "m"}))
    >>> tensors["a"], metadata
    (tensor([1., 1.]), {'unit': 'm'})
    """
    header: dict[str, Any] = {"__metadata__": dict(metadata)} if metadata else {}
    chunks, end = [], 0
    # Wide types first, as the format asks for, so that every tensor starts aligned.
    for name in sorted(tensors, key=lambda name: (-tensors[name].element_size(), name)):
        tensor = tensors[name].detach().cpu().contiguous()
        chunks.append(tensor.reshape(-1).view(torch.uint8).numpy().tobytes())
        start, end = end, end + len(chunks[-1])
        header[name] = {
            "dtype": _NAMES[tensor.dtype],
            "shape": list(tensor.shape),
            "data_offsets": [start, end],
        }
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + b"".join(chunks)


def unpack(content: bytes) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Return the tensors and the metadata of a file's content.

    Raises
    ------
    WeightsError
        If the content is cut short or no safetensors at all.
    """
    start = 8 + int.from_bytes(content[:8], "little")
    try:
        header = json.loads(content[8:start]) if 8 < start <= len(content) else None
        if not isinstance(header, dict):
            raise WeightsError(f"its header of {start - 8} bytes is not there")
        metadata = header.pop("__metadata__", {})
        body = np.frombuffer(content, dtype=np.uint8)[start:].copy()
        tensors = {name: _tensor(body, **entry) for name, entry in header.items()}
    except (ValueError, TypeError, KeyError) as error:
        raise WeightsError(f"its header cannot be read: {error!r}") from error
    if sum(tensor.nbytes for tensor in tensors.values()) != len(body):
        raise WeightsError(f"its tensors and its {len(body)} bytes of data do not match")
    return tensors, metadata


def _tensor(
    body: np.ndarray[Any, Any], *, dtype: str, shape: list[int], data_offsets: list[int]
) -> Tensor:
    a, b = data_offsets
    if not 0 <= a <= b <= len(body) or b - a != math.prod(shape) * _DTYPES[dtype].itemsize:
        raise WeightsError(f"its tensor of shape {shape} does not lie within the file")
    tensor = torch.empty(shape, dtype=_DTYPES[dtype])
    tensor.view(-1).view(torch.uint8).copy_(torch.from_numpy(body[a:b]))
    return tensor
