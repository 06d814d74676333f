"""Embeddings: analytic values, what they do not change with, batches, and what is refused."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
import torch
from conftest import creature
from scipy.spatial.transform import Rotation

import spectra_kit as sk
from spectra_kit import Arpack, PointCloud, TriangleMesh, eigensolve
from spectra_kit.errors import InvalidInputError
from spectra_kit.features import (
    BasisFunctions,
    Coordinates,
    Embedding,
    GlobalPointSignature,
    HeatKernelSignature,
    PositionalEncoding,
    ShapeDNA,
    Surface,
    WaveKernelSignature,
    embed,
    embed_batch,
    embed_shape,
)
from spectra_kit.geometry import sphere
from spectra_kit.neo import NeoConfig, NeoNetwork, NeoSubspace
from spectra_kit.operators import delaunay_laplacian

torch.manual_seed(0)
TINY = NeoNetwork(
    NeoConfig(width=36, depth=1, heads=2, head_width=18, latents=6, m=16, k=8, waves=4)
).eval()
SPECTRAL = [HeatKernelSignature(), WaveKernelSignature(), GlobalPointSignature(count=12)]
OF_SPACE = [
    Coordinates(),
    Coordinates(frame="principal"),
    PositionalEncoding(levels=3),
    BasisFunctions(subspace=sk.eigen.subspaces.AmbientFourier(m=16, bandwidth=2.0)),
    BasisFunctions(subspace=NeoSubspace(TINY, poses=4)),
    BasisFunctions(subspace=NeoSubspace(TINY), masses=False),
]
K = 36  # of the sphere: whole eigenspaces
ORDER = np.random.default_rng(0).permutation(900)


def triangles(index):
    """Two for each square of a grid of points."""
    a, b, c, d = (
        x.ravel() for x in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    )
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def grid(n, width=2.0, height=1.0):
    """A flat sheet, and the same rolled into half a tube."""
    u, v = np.meshgrid(np.linspace(0, width, 2 * n), np.linspace(0, height, n), indexing="ij")
    flat = np.stack([u, v, 0 * u], -1).reshape(-1, 3)
    angle = np.pi * u / width
    rolled = np.stack([np.cos(angle), np.sin(angle), v * np.pi / width], -1).reshape(-1, 3)
    faces = triangles(np.arange(2 * n * n).reshape(2 * n, n))
    return TriangleMesh(flat, faces), TriangleMesh(rolled, faces)


def test_signatures_of_the_sphere_are_those_of_its_eigenvalues():
    ball = sphere(subdivisions=4).geometry
    levels = np.arange(6)
    values, counts = 4 * np.pi * levels * (levels + 1), 2 * levels + 1
    times = np.geomspace(4 * np.log(10) / (4 * np.pi * K), 1.0, 16)
    heat = np.log(np.exp(-np.outer(values, times)).T @ counts)
    found = embed(ball, HeatKernelSignature(), k=K, solver=Arpack())
    np.testing.assert_allclose(found, np.broadcast_to(heat, found.shape), atol=0.03)
    waves = embed(ball, WaveKernelSignature(), k=K, solver=Arpack())
    np.testing.assert_allclose(waves, 0.0, atol=0.06)  # no place is another
    dna = embed_shape(ball, ShapeDNA(count=35), k=K, solver=Arpack())
    expected = np.repeat(levels * (levels + 1), counts)[1:] / np.arange(1, 36)
    np.testing.assert_allclose(dna, np.log(expected), atol=0.03)


@cache
def surfaces():
    """What embeddings are held against, each solved once for all of them."""
    cloud = creature(900, pose=2).points
    turn = Rotation.from_euler("xyz", [0.3, -1.1, 2.0]).as_matrix()
    flat, rolled = grid(n=30)
    animal = creature(6000)
    shapes = {
        "cloud": PointCloud(cloud),
        "scale": PointCloud(3.0 * cloud + [5.0, 0.0, 1.0]),
        "rotation": PointCloud(cloud @ turn.T),
        "shuffled": PointCloud(cloud[ORDER]),
        "flat": flat,
        "rolled": rolled,
        "sampled": sk.geometry.sample(animal, 1500, seed=0),
        "sampled again": sk.geometry.sample(animal, 1500, seed=1),
        "ball": sphere(subdivisions=4).geometry,
    }
    return {
        name: Surface(shape, 24 if shape in (flat, rolled) else 32, Arpack())
        for name, shape in shapes.items()
    }


@pytest.mark.parametrize("embedding", [*SPECTRAL, ShapeDNA(), *OF_SPACE], ids=str)
def test_an_embedding_changes_with_nothing_that_it_is_invariant_to(embedding):
    def of(name):
        found = embedding.of_all(surfaces()[name])
        if isinstance(embedding, ShapeDNA):
            return found, np.tile(found, (len(ORDER), 1))
        return found, embedding.of_points(surfaces()[name])

    whole, points = of("cloud")
    for name in ("scale", "rotation"):
        again, there = of(name)
        same = np.allclose(there, points, atol=2e-3 * np.abs(points).max())
        assert same == (name in embedding.invariant_to)
        assert np.allclose(again, whole, atol=2e-3 * np.abs(whole).max()) or not same
    shuffled, there = of("shuffled")
    np.testing.assert_allclose(there, points[ORDER], atol=2e-3 * np.abs(points).max())
    np.testing.assert_allclose(shuffled, whole, atol=2e-3 * np.abs(whole).max())


@pytest.mark.parametrize("embedding", [*SPECTRAL, *OF_SPACE], ids=str)
def test_spectral_ones_do_not_see_a_sheet_that_is_rolled(embedding):
    flat, rolled = (embedding.of_points(surfaces()[name]) for name in ("flat", "rolled"))
    apart = np.linalg.norm(flat - rolled) / np.linalg.norm(flat - flat.mean(axis=0))
    assert (apart < 0.05) == ("isometry" in embedding.invariant_to)


@pytest.mark.parametrize("embedding", [*SPECTRAL, ShapeDNA(), *OF_SPACE], ids=str)
def test_of_a_whole_surface_the_sampling_matters_less_than_the_surface(embedding):
    assert "sampling" in embedding.invariant_to
    one, again, far = (
        embedding.of_all(surfaces()[name]) for name in ("sampled", "sampled again", "ball")
    )
    assert np.linalg.norm(one - again) < 0.2 * np.linalg.norm(one - far)


def test_a_spectrum_is_enough_for_those_that_need_no_points():
    laplacian = delaunay_laplacian(creature(800))
    spectrum = eigensolve(laplacian, 40, Arpack())
    for embedding in SPECTRAL:
        truth = embed(laplacian, embedding, k=32, solver=Arpack())
        np.testing.assert_allclose(embed(spectrum, embedding, k=32), truth, atol=1e-6)
    for embedding in OF_SPACE:
        with pytest.raises(InvalidInputError, match="`surface` must have points"):
            embed(spectrum, embedding)
    with pytest.raises(InvalidInputError, match="`surface` must have k = 41 modes or more, got 40"):
        embed(spectrum, WaveKernelSignature(), k=41)
    with pytest.raises(InvalidInputError, match="call `embed_shape`"):
        embed(spectrum, ShapeDNA(), k=32)


def clouds():
    """Two clouds as a batch, the smaller one padded with what must not count."""
    rng = np.random.default_rng(0)
    few, many = (torch.from_numpy(rng.normal(size=(n, 3)) * [3, 2, 1]) for n in (60, 90))
    points = torch.stack([torch.cat([few, torch.full((30, 3), 7.0)]), many])
    mass = torch.from_numpy(rng.uniform(0.5, 1.5, (2, 90)))
    mass[0, 60:] = 0.0
    return points, mass, (few, many)


@pytest.mark.parametrize("embedding", OF_SPACE, ids=str)
def test_padding_changes_nothing_and_gradients_reach_the_points(embedding):
    points, mass, alone = clouds()
    points.requires_grad_()
    together = embed_batch(points, mass, embedding)
    for i, cloud in enumerate(alone):
        n = len(cloud)
        one = embed_batch(cloud[None], mass[i : i + 1, :n], embedding)[0]
        torch.testing.assert_close(together[i, :n], one, atol=1e-4, rtol=1e-3)
        assert not together[i, n:].any()
    weights = torch.from_numpy(np.random.default_rng(1).normal(size=together.shape)).float()
    (slope,) = torch.autograd.grad((weights * together).sum(), points)
    assert slope[0, 60:].abs().max() < 1e-30
    # Of a small change that leaves the frame as it is: of that of one cloud, held fixed by hand.
    step = torch.zeros_like(points)
    step[1, :, :] = torch.from_numpy(np.random.default_rng(2).normal(size=(90, 3)))
    frame = np.linalg.norm(step[1].numpy())
    step = step / frame

    def value(h):
        moved = points.detach() + h * step
        held = _held(points.detach()[1], mass[1], embedding)
        posed = (moved[1].double() - held[0]) @ held[1] / held[2]
        share = mass[1:] / mass[1:].sum()
        with torch.no_grad():
            found = embedding.values(posed.float()[None], share.float())
        return float((weights[1:] * found).double().sum())

    h = 1e-2
    measured = (value(h) - value(-h)) / (2 * h)
    assert float((slope * step).sum()) == pytest.approx(measured, rel=0.02, abs=0.02)


def _held(points, mass, embedding):
    from spectra_kit.features.space import _frame

    return tuple(torch.as_tensor(part) for part in _frame(points, mass, embedding.pose))


def test_functions_of_the_network_do_not_depend_on_which_flip_is_the_principal_one():
    points, mass, _ = clouds()
    embedding = BasisFunctions(subspace=NeoSubspace(TINY, poses=4))
    flip = torch.tensor([-1.0, 1.0, -1.0])
    posed = (points / points.abs().max()).float()
    share = (mass / mass.sum(1, keepdim=True)).float()
    with torch.no_grad():
        torch.testing.assert_close(
            embedding.values(posed, share), embedding.values(posed * flip, share)
        )
        alone = BasisFunctions(subspace=NeoSubspace(TINY))
        assert not torch.allclose(alone.values(posed, share), alone.values(posed * flip, share))
        blind = BasisFunctions(subspace=NeoSubspace(TINY, poses=4), masses=False)
        even = (mass > 0) / (mass > 0).sum(1, keepdim=True)
        torch.testing.assert_close(blind.values(posed, share), blind.values(posed, even))
        assert not torch.allclose(blind.values(posed, share), embedding.values(posed, share))


def test_positional_encoding_and_plane_waves_are_what_they_say():
    x = torch.tensor([[[0.25, -0.5, 1.0], [-0.25, 0.5, -1.0]]])
    mass = torch.ones(1, 2)
    found = embed_batch(x, mass, PositionalEncoding(levels=2))[0, 0]
    sines = [np.sin(np.pi * 2**e * c) for e in (0, 1) for c in (0.25, -0.5, 1.0)]
    cosines = [np.cos(np.pi * 2**e * c) for e in (0, 1) for c in (0.25, -0.5, 1.0)]
    np.testing.assert_allclose(found, [0.25, -0.5, 1.0, *sines, *cosines], atol=1e-6)
    cloud = creature(500).points
    for m in (44, 45):
        waves = sk.eigen.subspaces.AmbientFourier(m=m, bandwidth=3.0)
        theirs = waves(cloud, np.ones(500))[:, 4:]
        told = BasisFunctions(subspace=waves)
        ours = embed_batch(torch.tensor(cloud)[None], torch.ones(1, 500), told)
        np.testing.assert_allclose(ours[0], theirs, atol=1e-4)


def test_what_is_no_batch_and_no_option_is_refused():
    points, mass, _ = clouds()
    waves = BasisFunctions(subspace=sk.eigen.subspaces.AmbientFourier(m=64))
    for wrong, told in (
        ((points[0], mass, waves), r"`points` must have shape \(b, n, 3\), and `mass` \(b, n\)"),
        ((points, mass[:, :5], waves), r"`points` must have shape \(b, n, 3\), and `mass`"),
        ((points, -mass, waves), "`mass` must be positive at the points, zero at padding"),
        ((points, 0 * mass, waves), "`mass` must be positive at the points, zero at padding"),
        ((0 * points, mass, Coordinates()), "`points` must lie in more than one place"),
        ((points, mass, WaveKernelSignature()), "`embedding` must be a function of points"),
    ):
        with pytest.raises(InvalidInputError, match=told):
            embed_batch(*wrong)
    for make, told in (
        (lambda: HeatKernelSignature(count=1), "`count` must be at least 2"),
        (lambda: WaveKernelSignature(width=0.0), "`width` must be positive"),
        (lambda: GlobalPointSignature(count=0), "`count` must be at least 1"),
        (lambda: PositionalEncoding(levels=0), "`levels` must be at least 1"),
        (
            lambda: BasisFunctions(subspace=sk.eigen.subspaces.RandomBasis()),
            "`subspace` must be of functions",
        ),
    ):
        with pytest.raises(sk.SpectraKitError, match=told):
            make()
    with pytest.raises(InvalidInputError, match="`k` must be at least 1"):
        embed(creature(500), WaveKernelSignature(), k=0)
    with pytest.raises(InvalidInputError, match="`k` must be more than first = 40, got 36"):
        embed(creature(500), WaveKernelSignature(first=40), k=36)


def test_an_embedding_of_ones_own_is_one_and_must_be_finite():
    @dataclass(frozen=True)
    class Heights:
        bad: bool = False

        @property
        def invariant_to(self):
            return frozenset()

        def of_points(self, surface):
            return surface.laplacian.points[:, 2:] / (0.0 if self.bad else 1.0)

        def of_all(self, surface):
            return surface.mass @ self.of_points(surface)

    assert isinstance(Heights(), Embedding)
    cloud = creature(500)
    np.testing.assert_array_equal(embed(cloud, Heights())[:, 0], cloud.points[:, 2])
    with np.errstate(all="ignore"), pytest.raises(InvalidInputError, match="finite"):
        embed(cloud, Heights(bad=True))


def test_a_whole_surface_is_the_quantiles_by_area_of_its_points():
    """On a sheet that is sampled twice as densely on its left half."""
    x = np.concatenate([np.linspace(0, 1, 81), np.linspace(1, 2, 41)[1:]])
    u, v = np.meshgrid(x, np.linspace(0, 0.5, 21), indexing="ij")
    points = np.stack([u, v, 0 * u], -1).reshape(-1, 3)
    faces = triangles(np.arange(len(points)).reshape(u.shape))
    found = embed_shape(TriangleMesh(points, faces), Coordinates(), k=8).reshape(3, 10)
    levels = (np.arange(10) + 0.5) / 10
    np.testing.assert_allclose(found[0], 2 * levels - 1, atol=0.01)  # along, in the unit box
    np.testing.assert_allclose(found[1], (levels - 0.5) * 0.5, atol=0.01)
    np.testing.assert_allclose(found[2], 0, atol=1e-9)


def test_a_wave_signature_without_its_lowest_bands_minds_a_bridge_less():
    """A point of contact between two ends of a ring moves the lowest modes the most."""
    angle = np.linspace(0.15, 2 * np.pi - 0.15, 60)
    tube = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    a, t = np.meshgrid(angle, tube, indexing="ij")
    radius = 1 + 0.12 * np.cos(t)
    points = np.stack([radius * np.cos(a), radius * np.sin(a), 0.12 * np.sin(t)], -1)
    index = np.arange(a.size).reshape(a.shape)
    faces = triangles(np.hstack([index, index[:, :1]]))  # closed around the tube
    bridge = [[index[0, 0], index[-1, 0], index[0, 1]]]
    open_, joined = (
        TriangleMesh(points.reshape(-1, 3), f) for f in (faces, np.concatenate([faces, bridge]))
    )
    apart = []
    for waves in (
        WaveKernelSignature(count=12, width=1.5),
        WaveKernelSignature(count=12, width=1.5, first=8),
    ):
        one, two = (embed_shape(mesh, waves, k=64) for mesh in (open_, joined))
        apart.append(np.abs(one - two).mean() / one.std())
    assert apart[1] < 0.5 * apart[0], apart
