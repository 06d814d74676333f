"""The safetensors format: a length, a JSON header, and the bytes of the tensors.

Ours have a digest of everything among the metadata; files without one are read too.

The library of that name does the same; training must run where it is not installed, and two
readers of one format would be one too many. A test exchanges files with it.
"""

from __future__ import annotations

import hashlib
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
_DIGEST = "spectra_kit.sha256"  # among the metadata
_NAMES = {dtype: name for name, dtype in _DTYPES.items()}


def pack(tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> bytes:
    """Return the content of a file with these tensors; equal arguments give equal bytes.

    Examples
    --------
    >>> import torch
    >>> from spectra_kit.neo.safetensors_file import pack, unpack
    >>> tensors, metadata = unpack(pack({"a": torch.ones(2)}, {"unit": "m"}))
    >>> tensors["a"], metadata
    (tensor([1., 1.]), {'unit': 'm'})
    """
    header: dict[str, Any] = {}
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
    body = b"".join(chunks)
    header["__metadata__"] = {**metadata, _DIGEST: _digest(header, metadata, body)}
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + body


def unpack(content: bytes) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Return the tensors and the metadata of a file's content.

    Raises
    ------
    WeightsError
        If the content is cut short, changed (where it holds a digest, as that of `pack` does), or
        no safetensors at all.
    """
    start = 8 + int.from_bytes(content[:8], "little")
    try:
        header = json.loads(content[8:start]) if 8 < start <= len(content) else None
        if not isinstance(header, dict):
            raise WeightsError(f"its header of {start - 8} bytes is not there")
        body = np.frombuffer(content, dtype=np.uint8)[start:].copy()
        metadata = header.pop("__metadata__", {})
        if not isinstance(metadata, dict) or not all(isinstance(v, str) for v in metadata.values()):
            raise WeightsError(f"its metadata must map names to texts, got {metadata!r:.80}")
        _check_ranges([tuple(entry["data_offsets"]) for entry in header.values()], len(body))
        digest = metadata.pop(_DIGEST, None)
        if digest not in (None, _digest(header, metadata, body.data)):
            raise WeightsError(f"its content must have the sha256 {digest}, and has another")
        tensors = {name: _tensor(body, **entry) for name, entry in header.items()}
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise WeightsError(f"its header cannot be read: {error!r}") from error
    return tensors, metadata


def _digest(
    header: Mapping[str, Any], metadata: Mapping[str, str], body: bytes | memoryview
) -> str:
    """Return the sha256 of all that a file says: the format itself has no checksum."""
    told = hashlib.sha256(json.dumps([header, dict(metadata)]).encode())
    told.update(body)
    return told.hexdigest()


def _check_ranges(ranges: list[tuple[int, int]], size: int) -> None:
    """Refuse tensors that do not lie one after the other from the first byte to the last."""
    end = 0
    for start, stop in sorted(ranges):
        if start != end or stop < start:
            raise WeightsError(f"a tensor must begin at byte {end} of the data, got {start}")
        end = stop
    if end != size:
        raise WeightsError(f"its tensors and its {size} bytes of data do not match")


def _tensor(
    body: np.ndarray[Any, Any], *, dtype: str, shape: list[int], data_offsets: list[int]
) -> Tensor:
    a, b = data_offsets
    if not all(type(side) is int and side >= 0 for side in shape):
        raise WeightsError(f"a shape must be of whole numbers, got {shape}")
    if b - a != math.prod(shape) * _DTYPES[dtype].itemsize:
        raise WeightsError(f"its tensor of shape {shape} does not have {b - a} bytes")
    tensor = torch.empty(shape, dtype=_DTYPES[dtype])
    tensor.view(-1).view(torch.uint8).copy_(torch.from_numpy(body[a:b]))
    return tensor
