"""The study of a device, played by the host: what it tells, and what it leaves out in time."""

import json

from studies.run import main

SMALL = ["--device", "cpu:0", "--many", "530", "2", "--one", "530", "--network", "50"]


def test_the_study_tells_times_and_errors(tmp_path, capsys):
    assert main(["device", str(tmp_path), *SMALL, "--eigh", "34"]) == 0
    tables = json.loads((tmp_path / "device.json").read_text())["tables"]
    small, many, one, network = tables.values()
    assert all(row["worst"] < 1e-12 for row in small)
    assert [row["clouds"] for row in many] == [2, 2]
    assert all(0 < row["error, mean"] <= row["worst"] < 1e-2 for row in [*many, *one[:2]])
    assert len(network) == 2
    assert "left out: nothing" in capsys.readouterr().out


def test_what_time_does_not_suffice_for_is_told(tmp_path, capsys):
    assert main(["device", str(tmp_path), *SMALL, "--eigh", "34", "--minutes", "0"]) == 0
    assert "left out: Small symmetric eigenproblems, Many small clouds" in capsys.readouterr().out
    assert json.loads((tmp_path / "device.json").read_text())["tables"] == {}


def test_a_device_that_is_not_there_is_refused(tmp_path, capsys):
    assert main(["device", str(tmp_path), "--device", "abacus"]) != 0
    assert "`device` must be one that torch can use here" in capsys.readouterr().err
