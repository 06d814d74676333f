"""DiffusionNet as published, on our operators: the study from end to end where it is at hand."""

import json
import os
from pathlib import Path

import pytest
from studies import run as command

PEER = Path(os.environ.get("SPECTRA_KIT_DATA", ".")).parent / "peers" / "diffusion_net"


def test_a_folder_without_the_package_is_refused(tmp_path, capsys):
    assert command.main(["diffusion-net", str(tmp_path / "out"), "--peer", str(tmp_path)]) == 2
    assert "`peer` must hold diffusion_net/layers.py and pretrained/" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.data
def test_their_weights_say_the_same_on_our_operators(tmp_path):
    if not (PEER / "diffusion_net").is_dir():
        pytest.skip(f"no {PEER}")
    options = ["--bodies", "1", "--vertices", "600"]
    assert command.main(["diffusion-net", str(tmp_path), "--peer", str(PEER), *options]) == 0
    report = json.loads((tmp_path / "diffusion-net.json").read_text())
    same = {(m["maker"], m["inputs"]): m["as_theirs"][0] for m in report["marks"]}
    assert {share for (maker, _), share in same.items() if "their" in maker} == {100.0}
    assert min(share for (maker, _), share in same.items() if maker == "exact modes") > 90
    assert set(report["seconds"]) == {maker for maker, _ in same}
