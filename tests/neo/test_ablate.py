"""The ablation loop: equal protocol, one report, and nothing done twice."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from conftest import creature, ellipsoids
from studies import ablation as ablate
from studies import run as command

from spectra_kit.geometry import write
from spectra_kit.neo import NeoConfig, load_pretrained
from spectra_kit.neo.train.corpus import write_shard
from spectra_kit.neo.train.samples import Samples

BASE = NeoConfig(width=36, depth=1, heads=2, head_width=18, latents=6, m=24, k=8, waves=4)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Run the app on a tiny corpus and one mesh; return its exit code."""
    root = tmp_path_factory.mktemp("ablation")
    for name, seed in (("train", 0), ("validation", 1)):
        write_shard(root / name, 0, Samples(*ellipsoids(16, seed), {"family": np.zeros(16)}))
    (root / "meshes").mkdir()
    write(creature(600, seed=0), root / "meshes" / "animal.ply")

    def app(*options, samples=24):
        given = ["ablation", *(str(root / name) for name in ("out", "train", "validation"))]
        given += ["--data", str(root / "meshes"), "--samples", str(samples), "--batch", "4"]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(ablate, "TINY", BASE)
            return command.main([*given, "--sampled", "300", "--held-out", "6", *options])

    app.out = root / "out"
    return app


@pytest.fixture(scope="module")
def report(run):
    assert run("--only", "reference", "mass-agnostic", "plain") == 0
    return json.loads((run.out / "ablation.json").read_text())


def measured(out, variant):
    """The last errors of a variant, by set of clouds and by cloud."""
    records = map(json.loads, (out / "measurements.jsonl").read_text().splitlines())
    mine = [r for r in records if Path(r["contender"]).parent.name == variant]
    return {record["problem"]: record["errors"] for record in mine}


def test_every_variant_is_what_it_says_after_the_same_samples(run, report):
    assert list(report["variants"]) == ["reference", "mass-agnostic", "plain"]
    assert {row["samples"] for row in report["variants"].values()} == {24}
    for name, row in report["variants"].items():
        trained = load_pretrained(run.out / name / "weights.safetensors")
        assert (trained.config.waves, trained.config.mass_aware) == {
            "reference": (4, True),
            "mass-agnostic": (4, False),
            "plain": (0, True),
        }[name]
        assert row["parameters"] == sum(p.numel() for p in trained.network.parameters())
        assert row["weights"] == trained.sha256
        assert (run.out / name / "log.csv").is_file()


def test_errors_are_those_of_the_networks(run, report):
    row = report["variants"]["plain"]
    assert {cloud: span["clouds"] for cloud, span in row["span"].items()} == {
        "held-out": 6,
        "real": 1,
        "crowded": 1,
    }
    errors = measured(run.out, "plain")
    spans = [error["span"] for error in errors["held-out"].values()]
    assert row["span"]["held-out"]["mean"] == pytest.approx(np.mean(spans))
    assert row["span"]["real"]["mean"] == errors["real"]["animal"]["span"]
    # The basis holds the constant besides the network's m functions, which validation sees alone.
    network = load_pretrained(run.out / "plain" / "weights.safetensors").network
    points, mass, modes = ellipsoids(16, 1)
    basis = ablate.NeoSubspace(network)(points[0].astype(np.float32), mass[0])
    expected = ablate.span_error(basis, mass[0], modes[0]).mean()
    assert spans[0] == pytest.approx(expected, abs=2e-3)  # modes are stored as float16
    assert row["curve"][-1][0] == 24


def test_nothing_is_done_twice_and_another_protocol_is_refused(run, report, capsys):
    files = [run.out / "plain" / "weights.safetensors", run.out / "measurements.jsonl"]
    before = [file.stat().st_mtime_ns for file in files]
    assert run("--only", "plain") == 0
    assert [file.stat().st_mtime_ns for file in files] == before
    assert json.loads((run.out / "ablation.json").read_text()) == report
    assert "plain: span error" in capsys.readouterr().out
    assert run("--only", "plain", samples=40) == 2
    assert "was trained under another protocol" in capsys.readouterr().err


def test_other_files_under_the_same_names_are_other_files(run, report, capsys):
    mesh = run.out.parent / "meshes" / "animal.ply"
    before = mesh.read_bytes()
    write(creature(600, seed=1), mesh)
    assert run("--only", "plain") == 0
    spans = measured(run.out, "plain")["real"]
    assert spans["animal"]["span"] != report["variants"]["plain"]["span"]["real"]["mean"]
    mesh.write_bytes(before)
    shards = run.out.parent / "train"
    kept = shards.rename(run.out.parent / "kept")
    write_shard(shards, 0, Samples(*ellipsoids(16, 7), {"family": np.zeros(16)}))
    try:
        assert run("--only", "plain") == 2
    finally:
        shutil.rmtree(shards)
        kept.rename(shards)
    assert "was trained under another protocol, or on other samples" in capsys.readouterr().err


def test_variants_of_the_default_network_are_valid():
    for changes in ablate.VARIANTS.values():
        assert ablate.replace(ablate.TINY, **changes).m < 640
