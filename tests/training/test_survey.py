"""What a corpus is like: topology of known surfaces, statistics, and the sheet."""

import json
from dataclasses import replace

import numpy as np
import pytest
from inspect_corpus import Topology, main, read_config, survey, topology
from PIL import Image

from spectra_kit import Arpack, eigensolve, robust_laplacian
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import PointCloud, TriangleMesh, rectangle, sphere, torus
from spectra_kit.training import surfaces
from spectra_kit.training.corpus import CorpusConfig, generate, make_sample
from spectra_kit.training.shards import open_shards

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
        ball.points[ball.faces].reshape(-1, 3), np.arange(ball.faces.size).reshape(-1, 3)
    )
    assert topology(soup) == topology(ball)
    fin = TriangleMesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 0]], [[0, 1, 2], [0, 1, 3], [0, 1, 4]]
    )
    assert topology(fin) == Topology(1, False, True, None)


def test_survey_counts_and_measures(folder):
    found = survey(open_shards(folder), TINY, [5, 2, 0, 1])
    assert found.counts.samples == 6
    assert len(found.topologies) == 4
    facts = found.as_json()
    assert json.loads(json.dumps(facts)) == facts
    assert sum(facts["genus"].values()) == sum(t.genus is not None for t in found.topologies)
    laplacian = robust_laplacian(PointCloud(make_sample(TINY, 2).points.astype(np.float32)))
    values = eigensolve(laplacian, 10, Arpack()).eigenvalues * laplacian.area
    assert found.eigenvalues.shape == (4, 10)
    np.testing.assert_allclose(found.eigenvalues[1], values, rtol=2e-3, atol=1e-2)


def test_configuration_is_read_back(folder, tmp_path):
    assert read_config(folder) == TINY
    with pytest.raises(InvalidInputError, match=r"must hold a corpus with its corpus\.json"):
        read_config(tmp_path)
    stored = replace(TINY, seed=8).fingerprint() | {"format": 1}
    (tmp_path / "corpus.json").write_text(json.dumps(stored))
    with pytest.raises(InvalidInputError, match=r"another configuration: \['format'\] differ"):
        read_config(tmp_path)


def test_the_app_draws_a_sheet_and_a_table(folder, tmp_path, capsys):
    sheet = tmp_path / "sheet.png"
    code = main([str(folder), str(sheet), "-n", "6", "--surveyed", "3"])
    out, err = capsys.readouterr()
    if "OpenGL" in err:
        pytest.skip("no OpenGL library on this machine")
    assert code == 0, err
    assert "6 samples" in out
    assert "lambda_1 area" in out
    facts = json.loads(sheet.with_suffix(".json").read_text())
    assert (facts["samples"], facts["surveyed"]) == (6, 3)
    with Image.open(sheet) as picture:
        pixels = np.asarray(picture.convert("RGB"))
    assert 0.05 < (pixels < 250).any(axis=2).mean() < 0.9
    assert main([str(tmp_path / "nothing"), str(sheet)]) == 1
    assert "must hold a corpus" in capsys.readouterr().err
