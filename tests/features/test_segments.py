"""Orders and parts by modes: paths, necks, components, and the same shape sampled twice."""

import numpy as np
import pytest
from conftest import creature, joined, moved, refused
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from spectra_kit import Spectrum, TriangleMesh, spectrum
from spectra_kit.errors import AmbiguousModesWarning
from spectra_kit.features import fiedler_order, spectral_segments
from spectra_kit.geometry import permuted, rectangle, sample, sphere


def turned(s: Spectrum, seed: int = 0) -> Spectrum:
    """The same modes with other signs."""
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], s.k)
    return Spectrum(s.eigenvalues, s.eigenvectors * signs, s.mass, s.certificate)


def dumbbell(neck: float = 0.0, smaller: float = 1.0) -> TriangleMesh:
    """A ball drawn thin at a height, beyond which it is smaller."""
    ball = sphere(subdivisions=4).geometry
    x, y, z = ball.points.T
    width = 0.1 + np.minimum(1, (2.5 * (z - neck)) ** 2)
    size = np.where(z > neck, smaller, 1.0)
    return TriangleMesh(np.stack([width * size * x, width * size * y, 2 * z], axis=1), ball.faces)


def shared(first, second, one, other, mass) -> float:
    """Share of the area on which two cuts agree, by the best names for the parts of one."""
    near = cKDTree(second).query(first)[1]
    table = np.zeros((one.max() + 1, other.max() + 1))
    np.add.at(table, (one, other[near]), mass / mass.sum())
    return float(table[linear_sum_assignment(-table)].sum())


def test_a_strip_is_ordered_from_end_to_end() -> None:
    mesh = rectangle(n=400, width=4.0, height=1.0).geometry
    copy, _ = permuted(mesh)
    x = copy.points[fiedler_order(copy), 0]
    steps = np.diff(x) if x[0] < x[-1] else -np.diff(x)
    assert (steps > -1e-9).all()


@pytest.mark.parametrize("scale", [1e-90, 1.0, 1e90])
def test_the_thin_end_comes_last_whatever_the_signs_and_the_numbering(scale) -> None:
    mesh = dumbbell(neck=0.5, smaller=0.4)
    copy, truth = permuted(mesh.with_points(scale * mesh.points))
    s = spectrum(copy, 10)
    order = fiedler_order(s)
    assert sorted(order) == list(range(mesh.n))
    z = mesh.points[truth[order], 2]
    assert z[:100].max() < 0 < 0.5 < z[-100:].min()
    for seed in range(3):
        assert (fiedler_order(turned(s, seed)) == order).all()


def test_where_both_ends_are_alike_the_first_point_tells() -> None:
    mesh = rectangle(n=400, width=4.0, height=1.0).geometry
    for shape in (mesh, TriangleMesh(mesh.points[::-1], mesh.n - 1 - mesh.faces)):
        s = spectrum(shape, 10)
        order = fiedler_order(s)
        assert (fiedler_order(turned(s)) == order).all()
        assert np.flatnonzero(order == 0)[0] < mesh.n // 2


def test_components_are_ordered_one_after_the_other() -> None:
    strip = rectangle(n=300, width=4.0, height=1.0).geometry
    lone = joined(strip, moved(strip, 9, 0, 0), moved(dumbbell(0.5, 0.4), 0, 9, 0, scale=0.3))
    order = fiedler_order(spectrum(lone, 30))
    parts = lone.component_labels[order]
    assert (np.diff(parts) >= 0).all()
    for part in range(3):  # of equal strips, modes of one eigenvalue are mixed
        along = lone.points[order[parts == part], 0 if part < 2 else 2]
        steps = np.diff(along) * np.sign(along[-1] - along[0])
        assert (steps > -(1e-6 if part < 2 else 0.05)).all()
    refused("surface", "have a mode outside the kernel on each", fiedler_order, spectrum(lone, 4))


def test_on_a_sphere_the_order_is_told_to_be_one_of_many() -> None:
    with pytest.warns(AmbiguousModesWarning, match="any mix is a mode"):
        fiedler_order(spectrum(sphere(subdivisions=3).geometry, 10))


@pytest.mark.parametrize(("neck", "smaller"), [(0.0, 1.0), (0.4, 0.6), (-0.3, 1.0)])
def test_parts_of_a_dumbbell_end_at_its_neck(neck, smaller) -> None:
    mesh = dumbbell(neck, smaller)
    s = spectrum(mesh, 40)
    found = spectral_segments(s, 2)
    above = mesh.points[:, 2] / 2 > neck
    wrong = s.mass[(found == 1) != above].sum() / s.area
    assert min(wrong, 1 - wrong) < 0.02
    assert s.mass[found == 0].sum() >= s.mass[found == 1].sum()


def test_parts_do_not_depend_on_signs_numbers_or_the_unit_but_on_a_seed_at_most() -> None:
    mesh = creature(900)
    s = spectrum(mesh, 40)
    found = spectral_segments(s, 4)
    assert set(found) == set(range(4))
    areas = np.bincount(found, s.mass)
    assert (np.diff(areas) <= 0).all()
    assert (spectral_segments(turned(s), 4) == found).all()
    assert (spectral_segments(s.rescale(1e100), 4) == found).all()
    copy, truth = permuted(mesh)
    again = spectral_segments(spectrum(copy, 40), 4)
    assert shared(copy.points, mesh.points, again, found, s.mass[truth]) > 0.95
    other = spectral_segments(s, 4, seed=1)
    assert shared(mesh.points, mesh.points, other, found, s.mass) > 0.95


def test_a_shape_sampled_twice_is_cut_at_the_same_places() -> None:
    mesh = creature(2000)
    clouds = [sample(mesh, 1500, seed=seed) for seed in (0, 1)]
    spectra = [spectrum(cloud, 40) for cloud in clouds]
    for parts in (2, 4, 8):
        cuts = [spectral_segments(s, parts) for s in spectra]
        assert shared(clouds[0].points, clouds[1].points, *cuts, spectra[0].mass) > 0.95


@pytest.mark.filterwarnings("ignore::spectra_kit.errors.AmbiguousModesWarning")
def test_no_part_spans_two_components() -> None:
    strip = rectangle(n=300, width=4.0, height=1.0).geometry
    lone = joined(strip, moved(strip, 9, 0, 0, scale=0.2), moved(strip, 0, 9, 0))
    s = spectrum(lone, 40)
    for parts in (3, 4, 7):
        found = spectral_segments(s, parts)
        assert len(np.unique(found)) == parts
        for part in range(parts):
            assert len(np.unique(lone.component_labels[found == part])) == 1
    refused("parts", "be in [3, ", spectral_segments, s, 2)


def test_where_the_cut_could_be_elsewhere_it_is_told() -> None:
    with pytest.warns(AmbiguousModesWarning, match="elsewhere, about as well; ask for another"):
        spectral_segments(spectrum(sphere(subdivisions=3).geometry, 30), 4)
