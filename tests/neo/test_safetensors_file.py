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


def entry(shape, start, stop):
    return {"dtype": "F32", "shape": shape, "data_offsets": [start, stop]}


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (b"", "header of 0 bytes is not there"),
        (pack(TENSORS, {})[:60], r"header of \d+ bytes is not there"),
        (with_header([1]), "is not there"),
        (with_header(b"{no json"), "header cannot be read"),
        (with_header({"a": {"dtype": "F3", "shape": [], "data_offsets": [0, 8]}}), "cannot be"),
        (with_header({"a": {"shape": [2]}}), "header cannot be read"),
        (with_header({"a": entry([2], 0, 4)}), "its 8 bytes of data do not match"),
        (with_header({"a": entry([9], 0, 36)}), "its 8 bytes of data do not match"),
        (with_header({"a": entry([1], 0, 8)}), r"of shape \[1\] does not have 8 bytes"),
        (with_header({"a": entry([2], 0, 8), "b": entry([1], 4, 8)}), "begin at byte 8 .*, got 4"),
        (with_header({"a": entry([2], 0, 8), "b": entry([2], 0, 8)}), "begin at byte 8 .*, got 0"),
        (with_header({"a": entry([1], 4, 8)}), "must begin at byte 0 of the data, got 4"),
        (with_header({"a": entry([-1, -2], 0, 8)}), r"whole numbers, got \[-1, -2\]"),
        (with_header({"a": entry([2.0], 0, 8)}), r"whole numbers, got \[2.0\]"),
        (
            with_header({"a": entry([2], 0, 8), "__metadata__": None}),
            "map names to texts, got None",
        ),
        (with_header({"a": entry([2], 0, 8), "__metadata__": {"k": 1}}), "map names to texts, got"),
        (with_header(b"[" * 100_000), "header cannot be read"),
    ],
)
def test_broken_files_are_refused(content, match):
    with pytest.raises(WeightsError, match=match):
        unpack(content)


def test_no_flipped_bit_changes_a_value_unseen():
    """Nor a name or the metadata; without the digest the format lets them pass."""
    tensors = {"a": torch.rand(3), "b": torch.rand(2)}
    content, accepted = pack(tensors, {"key": "value"}), 0
    for bit in range(8 * len(content)):
        changed = bytearray(content)
        changed[bit // 8] ^= 1 << bit % 8
        try:
            back, metadata = unpack(bytes(changed))
        except WeightsError:
            continue
        assert_same(back, tensors)
        assert metadata["key"] == "value"
        accepted += 1
    assert accepted < 200  # of the name of the digest, without which there is none


def test_files_without_a_digest_are_read_too():
    content = with_header({"a": entry([2], 0, 8)})
    assert torch.equal(unpack(content)[0]["a"], torch.zeros(2))
