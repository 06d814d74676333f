"""Shipping weights: the tree afterwards holds the file, its hash and golden tensors that fit."""

import shutil
from pathlib import Path

import pytest
import ship_weights
import torch
from safetensors.torch import load_file

from spectra_kit.neo import NeoConfig, build_network
from spectra_kit.neo.pretrained import WEIGHTS, load_pretrained, save_weights

ROOT = Path(__file__).parents[2]
TINY = NeoConfig(width=36, depth=1, heads=2, head_width=18, latents=6, m=16, k=8)


@pytest.mark.parametrize("name", ["small", "another"])
def test_shipped_weights_are_registered_under_their_name(tmp_path, name):
    torch.manual_seed(0)
    source = tmp_path / "mine.safetensors"
    save_weights(source, build_network(TINY), {"steps": 3})
    (tmp_path / "tests" / "neo" / "golden").mkdir(parents=True)
    (tmp_path / "spectra_kit" / "neo" / "weights").mkdir(parents=True)
    code = tmp_path / "spectra_kit" / "neo" / "pretrained.py"
    shutil.copy(ROOT / "spectra_kit" / "neo" / "pretrained.py", code)
    digest = ship_weights.ship(name, source, tmp_path)
    namespace = {"__name__": "pretrained"}
    exec(compile(code.read_text(), code, "exec"), namespace)
    file = f"neo-{name}.safetensors"
    assert namespace["WEIGHTS"] == {**WEIGHTS, name: (file, digest)}
    shipped = load_pretrained(code.parent / "weights" / file)
    assert (shipped.sha256, shipped.record) == (digest, {"steps": 3})
    golden = load_file(tmp_path / "tests" / "neo" / "golden" / file)
    with torch.no_grad():
        basis = shipped.network(golden["points"][None], golden["mass"][None])[0]
    torch.testing.assert_close(basis, golden["basis"])


def test_other_files_are_refused(tmp_path, capsys):
    assert ship_weights.main(["small", str(tmp_path / "none.safetensors")]) == 2
    assert "does not exist" in capsys.readouterr().err
