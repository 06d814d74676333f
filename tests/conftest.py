"""Geometries and backends shared by the tests, and the real shapes where they are present."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from spectra_kit import (
    AmbientFourier,
    InvalidInputError,
    Laplacian,
    Lobpcg,
    TriangleMesh,
    cotan_laplacian,
    geometry,
    knn_laplacian,
    robust_laplacian,
)
from spectra_kit.catalogue import SOLVERS
from spectra_kit.eigensolvers import Eigensolver
from spectra_kit.geometry import rectangle, sphere, torus


@dataclass(frozen=True)
class Backend:
    """A solver and what it promises on the small geometries below."""

    solver: Eigensolver
    residual: float  # largest relative residual
    rounding: float = 1e-6  # relative change of eigenvalues when the input is moved and reordered

    def __str__(self) -> str:
        return repr(self.solver)


# What a solver is given and promises where that is not the default: a new one needs no line here.
OPTIONS = {
    "multilevel": {"rtol": 1e-8},
    "fourier": {"subspace": AmbientFourier(m=300, bandwidth=6.0)},
    "capped": {"n_points": 150, "sweeps": 3},
    "neo": {"poses": 1},
}
RESIDUAL = {"polished": 0.05}
ROUNDING = {
    "capped": 1e-2,  # the order of the points decides which of them make the subset
    "neo": 1e-3,  # a float32 network: rounding of its features moves the predicted span a little
}


def backends(*, approximate: bool) -> list[Backend]:
    """Solvers of the catalogue.

    Relative residuals of a smooth approximation are of order one: its few high frequencies weigh
    in the M^-1 norm with their eigenvalue. Accuracy of the eigenvalues is tested where it is
    claimed.
    """
    return [
        Backend(
            entry(**OPTIONS.get(name, {})),
            RESIDUAL.get(name, 3.0 if approximate else 1e-8),
            ROUNDING.get(name, 1e-6),
        )
        for name, entry in SOLVERS.items()
        if (entry.accuracy == "approximate") == approximate
    ]


APPROXIMATE_BACKENDS = backends(approximate=True)
EXACT_BACKENDS = [*backends(approximate=False), Backend(Lobpcg(preconditioner="amg"), 1e-8)]


@pytest.fixture(params=EXACT_BACKENDS + APPROXIMATE_BACKENDS, ids=str, scope="session")
def backend(request: pytest.FixtureRequest) -> Backend:
    return request.param


@pytest.fixture(params=EXACT_BACKENDS, ids=str, scope="session")
def exact_backend(request: pytest.FixtureRequest) -> Backend:
    return request.param


def refused(
    argument: str, expected: str, call: Callable[..., object], *given: object, **options: object
) -> None:
    """Assert that a call is refused for an argument, which must do or be what is expected."""
    with pytest.raises(InvalidInputError) as caught:
        call(*given, **options)
    assert str(caught.value).startswith(f"`{argument}` must {expected}")


# It takes a third of a second to make one, and many tests ask for the same.
creature = cache(geometry.creature)


def bumpy(n: int = 642) -> TriangleMesh:
    """A sphere with bumps of no symmetry: every low eigenvalue is simple."""
    ball = sphere(subdivisions=3 if n <= 642 else 4).geometry
    p = np.array(ball.points)
    wave = 0.2 * np.sin(2 * p[:, 0] + 1) + 0.15 * np.cos(3 * p[:, 1] - p[:, 2]) + 0.1 * p[:, 2] ** 3
    return TriangleMesh(p * (1 + wave[:, None]) * [1.0, 1.3, 1.7], ball.faces)


def two_parts(gap: float = 5.0) -> TriangleMesh:
    """A sphere and a smaller bumpy body beside it: two components."""
    a, b = sphere(subdivisions=2).geometry, bumpy()
    points = np.vstack([a.points, 0.5 * b.points + [gap, 0, 0]])
    return TriangleMesh(points, np.vstack([a.faces, b.faces + a.n]))


GEOMETRIES = {
    "sphere-mesh": lambda: robust_laplacian(sphere(subdivisions=3).geometry),
    "sphere-cotan": lambda: cotan_laplacian(sphere(subdivisions=3).geometry),
    "sphere-cloud": lambda: robust_laplacian(sphere(subdivisions=3).geometry.as_cloud()),
    "sphere-knn": lambda: knn_laplacian(sphere(subdivisions=3).geometry),
    "rectangle": lambda: robust_laplacian(rectangle(n=600).geometry),
    "rectangle-dirichlet": lambda: _dirichlet_rectangle(),
    "torus": lambda: robust_laplacian(torus().geometry),
    "bumpy": lambda: robust_laplacian(bumpy()),
    "two-parts": lambda: robust_laplacian(two_parts()),
}


def _dirichlet_rectangle() -> Laplacian:
    mesh = rectangle(n=600).geometry
    return robust_laplacian(mesh).dirichlet(mesh.boundary_vertices)


@cache  # pytest makes a fixture anew whenever it comes back to a parameter
def laplacian_of(name: str) -> Laplacian:
    return GEOMETRIES[name]()


@pytest.fixture(params=GEOMETRIES, scope="session")
def any_laplacian(request: pytest.FixtureRequest) -> Laplacian:
    return laplacian_of(request.param)


@pytest.fixture(scope="session")
def bumpy_laplacian() -> Laplacian:
    return robust_laplacian(bumpy())


def data_folder() -> Path | None:
    """Folder of real shapes: SPECTRA_KIT_DATA, or nothing."""
    path = os.environ.get("SPECTRA_KIT_DATA")
    return Path(path) if path else None


@pytest.fixture(scope="session")
def real_shapes() -> Path:
    folder = data_folder()
    if folder is None or not (folder / "ood_public").is_dir():
        pytest.skip("set SPECTRA_KIT_DATA to the folder of real shapes to run this")
    return folder / "ood_public"


def ellipsoids(n, seed):
    """Clouds on random ellipsoids, with polynomials of the coordinates as modes."""
    rng = np.random.default_rng(seed)
    points = rng.standard_normal((n, 64, 3))
    points /= np.linalg.norm(points, axis=2, keepdims=True)
    points *= rng.uniform(0.3, 1, (n, 1, 3))
    mass = rng.uniform(0.5, 1.5, (n, 64))
    mass /= mass.sum(1, keepdims=True)
    x, y, z = np.moveaxis(points, 2, 0)
    modes = np.stack([np.ones_like(x), x, y, z, x * y, x * z, y * z, x * x], axis=2)
    root = np.sqrt(mass)[..., None]
    return points, mass, np.linalg.qr(root * modes)[0] / root


@contextmanager
def produced_here(config, indices, workers):
    """Make the samples of a stream in this process, in place of `training.corpus.produced`."""
    from spectra_kit.training.corpus import packed_sample

    yield (packed_sample(config, index) for index in indices)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--damage",
        type=int,
        default=40,
        metavar="N",
        help="cases of each part of tests/damage (default 40; commands, which are slow, fewer)",
    )


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Show what became of the damaged cases, those of other processes of pytest-xdist too."""
    reports = [r for kind in ("passed", "failed") for r in terminalreporter.getreports(kind)]
    told = [json.loads(v) for r in reports for key, v in r.user_properties if key == "damage"]
    if told:
        terminalreporter.section("damage")
    for name, outcomes in sorted(told):
        counts = ", ".join(f"{count:,} {outcome}" for outcome, count in sorted(outcomes.items()))
        terminalreporter.line(f"{name}: {counts}")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that hold slow tests: processes that share the files end together."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)
    for item in items:
        if isinstance(item, pytest.DoctestItem):  # an example has what it imports, as if pasted
            item.dtest.globs = {"__name__": "__main__"}


@pytest.hookimpl(optionalhook=True)  # pytest-xdist may be away
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """Give a file to one process: what its tests share is made, and its kernels compiled, once."""
    from xdist.scheduler import LoadFileScheduling

    if config.getoption("dist") != "load":  # another one was asked for
        return None
    config.option.loadscopereorder = False  # keep the order above
    return LoadFileScheduling(config, log)
