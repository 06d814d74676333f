"""What a corpus is like: topology of known surfaces, statistics, and the sheet."""

import json
import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from spectra_kit import Arpack, eigensolve, robust_laplacian
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import PointCloud, TriangleMesh, rectangle, sphere, torus
from spectra_kit.training import surfaces
from spectra_kit.training.corpus import CorpusConfig, generate, make_sample
from spectra_kit.training.survey import Topology, read_config, survey, topology

TINY = CorpusConfig(seed=3, n_points=400, k=10, shard_size=4)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("corpus")
    generate(path, 6, config=TINY)
    return path


def test_topology_of_known_surfaces():
    ball, ring = sphere(subdivisions=2).geometry, torus(n=400).geometry
    assert topology(ball) == Topology(parts=1, closed=True, boundary=False, genus=0)
    assert topology(ring).genus == 1
    both = surfaces.join([ball, ring.with_points(ring.points + 9.0)])
    assert topology(both) == Topology(parts=2, closed=True, boundary=False, genus=1)
    assert topology(rectangle(n=100).geometry) == Topology(1, False, True, None)
    # Poles of many coincident corners are closed, and so are unwelded triangles.
    assert topology(surfaces.superquadric((0.3, 0.3), [1, 1, 1])).genus == 0
    soup = TriangleMesh(
        ball.points[ball.faces].reshape(-1, 3), np.arange(len(ball.faces) * 3).reshape(-1, 3)
    )
    assert topology(soup) == topology(ball)
    fin = TriangleMesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 0]], [[0, 1, 2], [0, 1, 3], [0, 1, 4]]
    )
    assert topology(fin) == Topology(1, False, True, None)


def test_survey_counts_and_measures(folder):
    found = survey(folder, n=4)
    assert found.counts.samples == 6
    assert len(found.topologies) == 4
    assert found.eigenvalues.shape == (4, 10)
    facts = found.as_json()
    assert json.loads(json.dumps(facts)) == facts
    assert sum(facts["genus"].values()) == sum(t.genus is not None for t in found.topologies)
    # The survey of all samples, in order of a permutation, holds the spectrum of sample 2.
    sample = make_sample(TINY, 2)
    laplacian = robust_laplacian(PointCloud(sample.points.astype(np.float32)))
    values = eigensolve(laplacian, 10, Arpack()).eigenvalues * laplacian.area
    every = survey(folder, n=6).eigenvalues
    nearest = every[np.abs(every - values).max(axis=1).argmin()]
    np.testing.assert_allclose(nearest, values, rtol=2e-3, atol=1e-2)


def test_configuration_is_read_back(folder, tmp_path):
    assert read_config(folder) == TINY
    with pytest.raises(InvalidInputError, match=r"must hold a corpus with its corpus\.json"):
        read_config(tmp_path)
    stored = TINY.fingerprint() | {"format": 1}
    (tmp_path / "corpus.json").write_text(json.dumps(stored))
    with pytest.raises(InvalidInputError, match=r"another configuration: \['format'\] differ"):
        survey(tmp_path)


def test_the_app_draws_a_sheet_and_a_table(folder, tmp_path, capsys):
    main = runpy.run_path(str(Path(__file__).parents[2] / "apps" / "inspect_corpus.py"))["main"]
    sheet = tmp_path / "sheet.png"
    code = main([str(folder), str(sheet), "-n", "6", "--surveyed", "3"])
    out, err = capsys.readouterr()
    if "OpenGL" in err:
        pytest.skip("no OpenGL library on this machine")
    assert code == 0, err
    assert "6 samples" in out
    assert "lambda_1 area" in out
    assert json.loads(sheet.with_suffix(".json").read_text())["samples"] == 6
    with Image.open(sheet) as picture:
        pixels = np.asarray(picture.convert("RGB"))
    assert 0.05 < (pixels < 250).any(axis=2).mean() < 0.9
    assert main([str(tmp_path / "nothing"), str(sheet)]) == 1
    assert "must hold a corpus" in capsys.readouterr().err


def test_survey_of_another_seed_differs(folder, tmp_path):
    generate(tmp_path, 4, config=replace(TINY, seed=8))
    assert read_config(tmp_path).seed == 8
    assert not np.allclose(survey(tmp_path, n=4).eigenvalues, survey(folder, n=4).eigenvalues)
