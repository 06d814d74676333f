import re

import pytest

from spectra_kit.benchmarks import main


def test_both_solvers_agree_and_both_are_timed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--points", "1500", "-k", "12", "--repeats", "1"]) == 0
    out = capsys.readouterr().out
    assert len(re.findall(r"\d\.\d\dx", out)) == 2
    assert float(out.split("eigenvalues: ")[1]) < 1e-8


def test_missing_file(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["/no/such/mesh.obj"]) == 2
    assert "error:" in capsys.readouterr().err
