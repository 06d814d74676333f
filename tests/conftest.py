"""Geometries and backends shared by the tests, and the real shapes where they are present."""

from __future__ import annotations

import gc
import os
import signal
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

# Processes of pytest-xdist share the cores, before NumPy is imported: threads of BLAS spin while
# they wait for one another, and beside other work a test of ten seconds then takes minutes.
if processes := os.environ.get("PYTEST_XDIST_WORKER_COUNT"):
    share = max(1, (os.cpu_count() or 1) // int(processes))
    os.environ.setdefault("OMP_NUM_THREADS", str(share))

# Where a shell runs this in the background, Ctrl-C is ignored, as by all that tests would start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

import numpy as np
import pytest

from spectra_kit import (
    InvalidInputError,
    Laplacian,
    Spectrum,
    TriangleMesh,
    cotan_laplacian,
    eigensolve,
    geometry,
    knn_laplacian,
    robust_laplacian,
)
from spectra_kit.catalogue import SOLVERS
from spectra_kit.eigen import Eigensolver
from spectra_kit.eigen.subspaces import AmbientFourier
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
    "fourier": {"subspace": AmbientFourier(m=300, bandwidth=6.0)},
    "cascade": {"coarsest": 150},
    "neo": {"poses": 1},
}
ROUNDING = {
    "cascade": 1e-2,  # the order of the points decides which of them make the levels
    "neo": 1e-3,  # a float32 network: rounding of its features moves the predicted span a little
}


# Relative residuals of a smooth approximation are of order one: its few high frequencies weigh in
# the M^-1 norm with their eigenvalue. Accuracy of the eigenvalues is tested where it is claimed.
BACKENDS = [
    Backend(
        entry(**OPTIONS.get(name, {})),
        3.0 if entry.promise == "approximate" else 1e-8,
        ROUNDING.get(name, 1e-6),
    )
    for name, entry in SOLVERS.items()
]


@pytest.fixture(params=BACKENDS, ids=str, scope="session")
def backend(request: pytest.FixtureRequest) -> Backend:
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


def ball(n: int, seed: int = 0) -> np.ndarray:
    """Random points on the unit sphere."""
    points = np.random.default_rng(seed).standard_normal((n, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


@cache
def bumpy(n: int = 642) -> TriangleMesh:
    """A sphere with bumps of no symmetry: every low eigenvalue is simple."""
    ball = sphere(subdivisions=2 if n <= 162 else 3 if n <= 642 else 4).geometry
    p = np.array(ball.points)
    wave = 0.2 * np.sin(2 * p[:, 0] + 1) + 0.15 * np.cos(3 * p[:, 1] - p[:, 2]) + 0.1 * p[:, 2] ** 3
    return TriangleMesh(p * (1 + wave[:, None]) * [1.0, 1.3, 1.7], ball.faces)


def joined(*meshes: TriangleMesh) -> TriangleMesh:
    """Several meshes as one, where they are."""
    first = np.cumsum([0, *(mesh.n for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, first[:-1], strict=True)]
    return TriangleMesh(np.vstack([mesh.points for mesh in meshes]), np.vstack(faces))


def moved(mesh: TriangleMesh, *to: float, scale: float = 1.0) -> TriangleMesh:
    """A mesh scaled, then moved."""
    return mesh.with_points(scale * mesh.points + to)


def moebius(n: int = 60, m: int = 6) -> TriangleMesh:
    """A strip that is twisted once before its ends are joined: it has one side."""
    around, across = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    angle = 2 * np.pi * around.ravel() / n
    offset = 0.8 * (across.ravel() / (m - 1) - 0.5) + 0.01 * np.random.default_rng(0).random(n * m)
    radius = 1 + offset * np.cos(angle / 2)
    points = np.c_[radius * np.cos(angle), radius * np.sin(angle), offset * np.sin(angle / 2)]
    i, j = np.arange(n)[:, None], np.arange(m - 1)
    far = (i + 1) % n
    turned = np.where(far == 0, m - 1 - np.arange(m), np.arange(m))  # upside down after a turn
    a, b = i * m + j, i * m + j + 1
    c, d = far * m + turned[:, 1:], far * m + turned[:, :-1]
    faces = np.concatenate([np.stack([a, d, c], 2), np.stack([a, c, b], 2)])
    return TriangleMesh(points, faces.reshape(-1, 3))


def two_parts(gap: float = 5.0) -> TriangleMesh:
    """A sphere and a smaller bumpy body beside it: two components."""
    return joined(sphere(subdivisions=2).geometry, moved(bumpy(), gap, 0, 0, scale=0.5))


def two_sheets(n: int = 300, apart: float = 0.0) -> TriangleMesh:
    """Two sheets, joined along their boundary: half of all modes are odd across them."""
    sheet = rectangle(n=n).geometry
    inner = np.setdiff1d(range(sheet.n), sheet.boundary_vertices)
    back = np.arange(sheet.n)
    back[inner] = sheet.n + np.arange(len(inner))
    points = np.vstack([sheet.points, sheet.points[inner] + [0, 0, apart]])
    return TriangleMesh(points, np.vstack([sheet.faces, back[sheet.faces][:, ::-1]]))


def _dirichlet_rectangle() -> Laplacian:
    mesh = rectangle(n=600).geometry
    return robust_laplacian(mesh).dirichlet(mesh.boundary_vertices)


GEOMETRIES = {
    "sphere-knn": lambda: knn_laplacian(sphere(subdivisions=3).geometry),
    "rectangle-cloud": lambda: robust_laplacian(rectangle(n=600).geometry.as_cloud()),
    "rectangle-dirichlet": _dirichlet_rectangle,
    "torus-cotan": lambda: cotan_laplacian(torus(n=500).geometry),
    "two-parts": lambda: robust_laplacian(two_parts()),
}
laplacian_of = cache(lambda name: GEOMETRIES[name]())  # pytest makes fixtures anew


@pytest.fixture(params=GEOMETRIES, scope="session")
def any_laplacian(request: pytest.FixtureRequest) -> Laplacian:
    return laplacian_of(request.param)


@pytest.fixture(scope="session")
def bumpy_laplacian() -> Laplacian:
    return robust_laplacian(bumpy())


@pytest.fixture(scope="session")
def animal() -> Laplacian:
    return robust_laplacian(creature(3000, seed=0))


@pytest.fixture(scope="session")
def animal_spectrum(animal: Laplacian) -> Spectrum:
    return eigensolve(animal, 70)


@pytest.fixture(scope="session")
def body() -> object:
    """The linear system that the tests of its solvers share."""
    from one_system import Body

    return Body()


def whole_spectrum(laplacian: Laplacian) -> tuple[np.ndarray, np.ndarray]:
    """All eigenvalues and modes on the free points, by LAPACK."""
    free = laplacian.free
    root = 1 / np.sqrt(laplacian.mass[free])
    stiffness = laplacian.stiffness[free][:, free].toarray()
    values, vectors = np.linalg.eigh(root[:, None] * stiffness * root)
    return np.maximum(values, 0), vectors * root[:, None]


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


_samples: dict[tuple[str, int], object] = {}


def made_once(config, index):
    """Make a sample as `neo.train.samples.make_sample` does, but none twice: it takes a while."""
    from spectra_kit.neo.train.samples import make_sample

    asked = repr(config), index
    if asked not in _samples:
        _samples[asked] = make_sample(config, index)
    return _samples[asked]


def produced_here(config, indices, workers):
    """Make the samples of a stream in this process, in place of `neo.train.corpus.produced`."""
    for index in indices:
        yield made_once(config, index)


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
    reports = terminalreporter.getreports("passed")
    told = Counter(value for r in reports for key, value in r.user_properties if key == "damage")
    if told:
        terminalreporter.section("damage")
    for outcome, count in sorted(told.items()):
        terminalreporter.line(f"{outcome}: {count:,}")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that hold slow tests: processes that share the files end together."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)
    for item in items:
        if isinstance(item, pytest.DoctestItem):  # an example has what it imports, as if pasted
            item.dtest.globs = {"__name__": "__main__"}


def pytest_collection_finish() -> None:
    """Leave what is imported by now out of collections of garbage, which `clocked` asks for."""
    gc.freeze()


@pytest.hookimpl(optionalhook=True)  # pytest-xdist may be away
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """Give a file to one process: what its tests share is made, and its kernels compiled, once."""
    from xdist.scheduler import LoadFileScheduling

    if config.getoption("dist") != "load":  # another one was asked for
        return None
    config.option.loadscopereorder = False  # keep the order above
    return LoadFileScheduling(config, log)
