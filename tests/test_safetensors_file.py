"""Our safetensors files are those of the library of that name."""

import json

import pytest
import torch
from safetensors.torch import load, save

from spectra_kit.errors import WeightsError
from spectra_kit.neo.safetensors_file import pack, unpack

TENSORS = {
    "b.half": torch.arange(6).reshape(2, 3).half() / 3,
    "a.brain": torch.tensor([1e-20, -3.0]).bfloat16(),
    "c": torch.rand(2, 1, 2, generator=torch.Generator().manual_seed(0)),
    "scalar": torch.tensor(7),
    "none": torch.empty(0, 4),
    "d": torch.tensor([True, False]),
}


def assert_same(one, other):
    assert one.keys() == other.keys()
    for name, tensor in one.items():
        assert tensor.dtype == other[name].dtype
        assert torch.equal(tensor, other[name])


def test_the_library_reads_what_we_write():
    assert_same(load(pack(TENSORS, {"key": "välue"})), TENSORS)


def test_we_read_what_the_library_writes():
    tensors, metadata = unpack(save(TENSORS, {"key": "välue"}))
    assert_same(tensors, TENSORS)
    assert metadata == {"key": "välue"}
    assert unpack(pack(TENSORS, {}))[1] == {}


def test_equal_tensors_give_equal_bytes():
    assert pack(TENSORS, {"a": "1"}) == pack(dict(reversed(TENSORS.items())), {"a": "1"})


def with_header(header):
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + bytes(8)


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (b"", "header of 0 bytes is not there"),
        (pack(TENSORS, {})[:60], r"header of \d+ bytes is not there"),
        (with_header([1]), "is not there"),
        (with_header(b"{no json"), "header cannot be read"),
        (with_header({"a": {"dtype": "F3", "shape": [], "data_offsets": [0, 4]}}), "cannot be"),
        (with_header({"a": {"shape": [2]}}), "header cannot be read"),
        (with_header({"a": {"dtype": "F32", "shape": [2], "data_offsets": [0, 4]}}), "not lie"),
        (with_header({"a": {"dtype": "F32", "shape": [9], "data_offsets": [0, 36]}}), "not lie"),
        (with_header({"a": {"dtype": "F32", "shape": [1], "data_offsets": [0, 4]}}), "8 bytes of"),
    ],
)
def test_broken_files_are_refused(content, match):
    with pytest.raises(WeightsError, match=match):
        unpack(content)
