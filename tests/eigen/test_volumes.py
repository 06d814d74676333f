"""Spectra of volumes: units, files, descriptors, solvers and what they choose, pictures."""

import json
from pathlib import Path

import numpy as np
import pytest
from volumes import ball, ball_eigenvalues, box

import spectra_kit as sk
from spectra_kit._sparse.memory import factor_gigabytes
from spectra_kit._sparse.pencil import Pencil
from spectra_kit._sparse.slicing import sliced_eigenpairs
from spectra_kit.eigen.multigrid import well_spread
from spectra_kit.eigen.subspaces import Union
from spectra_kit.errors import InvalidInputError
from spectra_kit.features import HeatKernelSignature, ShapeDNA, WaveKernelSignature
from spectra_kit.geometry import TetrahedralMesh
from spectra_kit.operators import schroedinger, tetrahedral_laplacian

K = 20


def scaled(mesh: TetrahedralMesh, factor: float) -> sk.Laplacian:
    return tetrahedral_laplacian((factor * mesh.points, mesh.cells))


def block() -> TetrahedralMesh:
    return box(8, 9, 10)


def test_rescaled_is_solved_at_that_size() -> None:
    found, larger = (sk.eigensolve(scaled(block(), s), K) for s in (1.0, 10.0))
    rescaled = found.rescale(10.0)
    assert rescaled.eigenvalues[1:] == pytest.approx(larger.eigenvalues[1:], rel=1e-9)
    assert rescaled.mass == pytest.approx(larger.mass, rel=1e-12)
    assert rescaled.orthonormality_error() < 1e-12
    residuals = rescaled.residuals(scaled(block(), 10.0))
    assert residuals.max() < 1e-9 * rescaled.eigenvalues[-1]
    assert rescaled.area == pytest.approx(1000 * found.area)
    with pytest.raises(InvalidInputError, match=r"whose cubes are numbers"):
        found.rescale(1e120)


def test_zero_modes_are_told_in_any_unit_without_an_operator() -> None:
    found = sk.eigensolve(tetrahedral_laplacian(block()), 4)
    bare = sk.Spectrum(
        found.eigenvalues + 1e-9, found.eigenvectors, found.mass, dimension=found.dimension
    )
    assert [bare.rescale(s).n_zero_modes for s in (1e-6, 1.0, 1e6)] == [1, 1, 1]


def test_all_that_is_derived_keeps_the_dimension() -> None:
    laplacian = tetrahedral_laplacian(block())
    some = np.arange(300)
    derived = (laplacian.dirichlet([0]), laplacian.restricted(some), schroedinger(laplacian, 1.0))
    assert {one.dimension for one in derived} == {3}
    found = sk.eigensolve(laplacian, 6)
    assert {s.dimension for s in (found, found.truncate(3), found.nonzero())} == {3}
    assert repr(found).startswith("Spectrum(of a volume, n=990")
    assert "990 in a volume" in found._repr_html_()
    flat = sk.Laplacian(laplacian.stiffness, laplacian.mass, laplacian.points)
    hashes = {sk.eigensolve(one, 2).provenance.input_hash for one in (laplacian, flat)}
    assert len(hashes) == 2
    for kind in (sk.Laplacian, sk.Spectrum):
        given = (
            (laplacian.stiffness, laplacian.mass, laplacian.points)
            if kind is sk.Laplacian
            else (found.eigenvalues, found.eigenvectors, found.mass)
        )
        with pytest.raises(InvalidInputError, match=r"`dimension` must be in \[2, 3\]"):
            kind(*given, dimension=4)


def test_files_keep_the_dimension_and_older_ones_are_of_surfaces(tmp_path: Path) -> None:
    path, older = tmp_path / "block.npz", tmp_path / "older.npz"
    found = sk.eigensolve(tetrahedral_laplacian(block()), 4)
    found.save(path)
    assert sk.Spectrum.load(path).dimension == 3
    sphere = sk.spectrum(sk.geometry.sphere(subdivisions=2).geometry, 4)
    sphere.save(path)
    with np.load(path) as file:
        arrays = dict(file)
    header = json.loads(str(arrays.pop("header")))
    assert header.pop("dimension") == 2
    np.savez(older, header=np.array(json.dumps(header | {"version": 6})), **arrays)
    assert sk.Spectrum.load(older).dimension == 2


def test_descriptors_know_no_unit() -> None:
    first, second = (scaled(block(), s) for s in (1.0, 1e4))
    for embedding in (HeatKernelSignature(count=5), WaveKernelSignature(count=5), ShapeDNA()):
        call = sk.features.embed_shape if isinstance(embedding, ShapeDNA) else sk.features.embed
        near, far = (call(one, embedding, k=40) for one in (first, second))
        assert near == pytest.approx(far, rel=1e-6, abs=1e-6)


def test_shape_dna_follows_weyls_law() -> None:
    dna = ball_eigenvalues(80, zero=True)
    mass = np.full(81, 4 * np.pi / 3 / 81)
    vectors = np.linalg.qr(np.random.default_rng(0).standard_normal((81, 80)))[0]
    spectrum = sk.Spectrum(dna, vectors / np.sqrt(mass)[:, None], mass, dimension=3)
    weyl = (6 * np.pi**2 * np.arange(1, 81)) ** (2 / 3)
    by_volume = sk.features.shape_dna(spectrum)
    assert by_volume == pytest.approx(dna * spectrum.area ** (2 / 3), rel=1e-12)
    # Zero values at the surface take from the number of modes: Weyl's second term.
    assert (by_volume > weyl).all()
    assert by_volume[-1] / weyl[-1] < 1.45
    fitted = sk.features.shape_dna(spectrum, normalize="weyl")
    assert fitted / by_volume == pytest.approx(np.full(80, fitted[0] / by_volume[0]), rel=1e-12)
    assert (fitted @ weyl) / (weyl @ weyl) == pytest.approx(1.0, rel=1e-12)


def test_the_cascade_solves_volumes_as_accurately_as_it_says() -> None:
    for mesh in (ball(15), box(30, 10, 10, sides=(3.0, 1.0, 1.0))):
        laplacian = tetrahedral_laplacian(mesh)
        exact = sk.eigensolve(laplacian, 2 * K, sk.Lanczos()).eigenvalues[1:]
        for factor in (1.0, 1e5):  # the radius of its balls is a length
            found = sk.eigensolve(scaled(mesh, factor), 2 * K, sk.Cascade())
            assert found.provenance.name == "cascade"
            errors = found.eigenvalues[1:] * factor**2 / exact - 1
            assert 0 < errors.mean() < 1e-3
            assert errors.mean() < 3 * found.certificate.errors.mean()


def test_levels_are_the_same_in_any_unit() -> None:
    subsets = [well_spread(scaled(ball(10), 2.0**power), 200) for power in (0, 20)]
    assert (subsets[0].indices == subsets[1].indices).all()
    assert subsets[1].radius == pytest.approx(2.0**20 * subsets[0].radius, rel=1e-12)


def test_a_level_may_have_fewer_points_than_the_next_is_to_have() -> None:
    grid = box(40, 18, 18, sides=(3.0, 1.0, 1.0))  # of which balls hold one point or many
    found = sk.eigensolve(tetrahedral_laplacian(grid), 100, sk.Cascade())
    assert found.provenance.name == "cascade"


def test_what_is_exact_is_proved_with_any_solver() -> None:
    laplacian = tetrahedral_laplacian(ball(12))
    spectra = [sk.eigensolve(laplacian, K, s) for s in (sk.Arpack(), sk.Lanczos(), sk.Refined())]
    for found in spectra:
        assert found.certificate.level == "verified"
        assert found.eigenvalues[1:] == pytest.approx(spectra[0].eigenvalues[1:], rel=1e-7)


def test_shifts_follow_weyls_law() -> None:
    laplacian = tetrahedral_laplacian(ball(13))
    spacing = laplacian.eigenvalue_spacing
    given = (laplacian.stiffness, laplacian.mass, 200)
    shifts = [
        sliced_eigenpairs(*given, below=-0.1 * spacing, spacing=spacing, power=power).shifts
        for power in (1.0, 2 / 3)
    ]
    assert shifts[1] < shifts[0] / 2


def test_factors_of_volumes_are_as_large_as_foretold_and_count() -> None:
    for n in (12, 20):
        laplacian = tetrahedral_laplacian(ball(n))
        needed, told = laplacian._elimination.gigabytes, factor_gigabytes(laplacian.n, 3)
        assert told / 2 < needed < told
        assert factor_gigabytes(laplacian.n) < needed / 2
    found = sk.eigensolve(laplacian, 60)
    middle = found.eigenvalues[29:31].mean()  # fronts of 800 rows
    factor = Pencil(laplacian.stiffness, laplacian.mass).factor(middle)
    assert factor.inertia.negative == 30
    x = np.random.default_rng(0).standard_normal(laplacian.n)
    b = laplacian.stiffness @ x - middle * laplacian.mass * x
    assert np.abs(factor.solve(b) - x).max() < 1e-8


def test_automatic_knows_that_factors_are_larger() -> None:
    n = 600_000
    assert isinstance(sk.Automatic().choose(n, K)[0], sk.Lanczos)
    solver, reason = sk.Automatic().choose(n, K, 3)
    assert isinstance(solver, sk.Cascade)
    assert "GiB, more than 8" in reason
    assert isinstance(sk.Automatic(accuracy=1e-3).choose(30_000, K, 3)[0], sk.Cascade)
    assert isinstance(sk.Automatic(accuracy=1e-3).choose(30_000, K)[0], sk.Lanczos)


def test_what_has_learned_surfaces_refuses_volumes() -> None:
    laplacian, neo = tetrahedral_laplacian(block()), sk.Neo()
    waves = sk.eigen.subspaces.AmbientFourier(m=64)
    solvers = (
        neo,
        sk.RayleighRitz(subspace=neo.subspace),
        sk.Cascade(subspace=neo.subspace),
        sk.Refined(start=Union(waves, neo.subspace)),
    )
    for solver in solvers:
        for call in (sk.eigensolve, lambda one, k, s: sk.eigensolve_many([one], k, s)):
            with pytest.raises(InvalidInputError, match="must be given surfaces"):
                call(laplacian, K, solver)
    with pytest.raises(InvalidInputError, match="must be given surfaces"):
        sk.features.embed(laplacian, sk.features.BasisFunctions(subspace=neo.subspace))
    assert sk.eigensolve(laplacian, K, sk.Refined(start=waves)).k == K


@pytest.mark.parametrize("scale", [1e-60, 1.0, 1e60])
def test_a_cut_shows_the_inside(scale: float) -> None:
    pytest.importorskip("pyvista")
    whole = block()
    mesh = TetrahedralMesh(scale * whole.points, whole.cells)
    surface, values = sk.show.cut_open(mesh, whole.points, normal=[0.0, 0.0, 2.0])
    extent = np.ptp(whole.points, axis=0) / [1, 1, 2]
    assert np.ptp(surface.points / scale, axis=0) == pytest.approx(extent, rel=1e-6)
    assert np.abs(values - surface.points / scale).max() < 1e-6
    a, b, c = (surface.points / scale)[surface.faces.T]
    assert (a * np.cross(b, c)).sum() / 6 == pytest.approx(whole.volume / 2, rel=1e-6)


def test_what_cannot_be_cut_is_refused() -> None:
    with pytest.raises(InvalidInputError, match=r"`values` must have shape \(990, c\)"):
        sk.show.cut_open(block(), np.zeros(7))
    with pytest.raises(InvalidInputError, match="`normal` must be a vector of three"):
        sk.show.cut_open(block(), np.zeros(990), normal=[0, 0, 0])
