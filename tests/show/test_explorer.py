"""The page that the explorer writes: its numbers, its size, and what it refuses. No browser."""

import base64
import gzip
import hashlib
import json
import re
from pathlib import Path

import numpy as np
import pytest
from conftest import bumpy

from spectra_kit import Arpack, Cascade, RayleighRitz, Spectrum, eigensolve, robust_laplacian
from spectra_kit.eigen.metrics import align_modes, compare_spectra
from spectra_kit.eigen.subspaces import GivenBasis
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import PointCloud, TriangleMesh, rectangle, sphere
from spectra_kit.show.contours import triangles_of
from spectra_kit.show.explorer import write_explorer
from spectra_kit.show.explorer.display import for_display
from spectra_kit.show.explorer.payload import walk
from spectra_kit.show.modes import display_signs
from spectra_kit.show.render import ball_diameter
from spectra_kit.show.spectra import free_boundary

SMALL = sphere(subdivisions=1).geometry
PACKAGE = Path(walk.__code__.co_filename).parent


@pytest.fixture(scope="module")
def mesh() -> TriangleMesh:
    return bumpy()


@pytest.fixture(scope="module")
def exact(mesh) -> Spectrum:
    return eigensolve(robust_laplacian(mesh), 8, Arpack())


@pytest.fixture(scope="module")
def predicted(exact) -> Spectrum:
    """The exact modes in another order and with other signs, and a little beside the truth."""
    noise = np.random.default_rng(0).normal(size=exact.eigenvectors.shape)
    vectors = exact.eigenvectors + 0.01 * np.abs(exact.eigenvectors).max() * noise
    skew = np.linalg.cholesky(vectors.T @ (exact.mass[:, None] * vectors))
    vectors = np.linalg.solve(skew, vectors.T).T
    vectors = vectors[:, [0, 2, 1, 3, 4, 5, 6, 7]] * [1, -1, 1, -1, 1, -1, 1, -1]
    return Spectrum(exact.eigenvalues * 1.01, vectors, exact.mass)


class Page:
    """A written page, read the way the browser does it."""

    def __init__(self, path: Path) -> None:
        self.text = path.read_text("utf-8")
        self.facts = json.loads(re.search(r'id="facts">(.*?)</script>', self.text, re.S)[1])
        blocks = re.findall(r'octet-stream" id="(\w+)">([^<]*)<', self.text)
        self.blocks = {name: gzip.decompress(base64.b64decode(text)) for name, text in blocks}

    @property
    def n(self) -> int:
        return self.facts["shown"]

    def modes(self, name: str) -> np.ndarray:
        k = len(self.facts["exact"]["eigenvalues"])
        scale = np.array(self.facts["colours"]["scale"])
        return columns16(self.blocks[name], self.n, k, np.int16) * (scale / 32767)

    def points(self) -> np.ndarray:
        """Positions in a box of side one, from its lowest corner."""
        return columns16(self.blocks["geometry"], self.n, 3, np.uint16) / 65535

    def faces(self) -> np.ndarray:
        f, data = self.facts["faces"], self.blocks["geometry"][6 * self.n :]
        first, second, third = (numbers32(data[4 * f * i :], f) for i in range(3))
        return np.column_stack([first, first + second, first + third])


def columns16(data: bytes, n: int, k: int, dtype: type) -> np.ndarray:
    planes = np.frombuffer(data, np.uint8, 2 * n * k).reshape(k, 2, n).astype(np.int64)
    zigzag = planes[:, 0] << 8 | planes[:, 1]
    return np.cumsum((zigzag >> 1) ^ -(zigzag & 1), axis=1).astype(dtype).T


def numbers32(data: bytes, n: int) -> np.ndarray:
    planes = np.frombuffer(data, np.uint8, 4 * n).reshape(4, n).astype(np.int64)
    zigzag = planes[0] << 24 | planes[1] << 16 | planes[2] << 8 | planes[3]
    return np.cumsum((zigzag >> 1) ^ -(zigzag & 1))


def test_the_page_holds_modes_and_geometry_to_within_its_promise(
    mesh, exact, predicted, tmp_path, monkeypatch
):
    told, pages = [], []
    for day, name in ((1e9, "one.html"), (2e9, "two.html")):
        monkeypatch.setattr("time.time", lambda now=day: now)
        options = {"title": "bumps", "progress": lambda *step: told.append(step)}
        written = write_explorer(tmp_path / name, mesh, exact, predicted, **options)
        pages.append(written.path.read_bytes())
    assert pages[0] == pages[1]
    assert told == 2 * [(1, 4), (2, 4), (3, 4), (4, 4)]
    page, order, root = Page(written.path), walk(mesh), np.sqrt(exact.area)
    assert sorted(order) == list(range(mesh.n))
    aligned = align_modes(exact, predicted)
    for name, vectors in (("exact", exact.eigenvectors), ("predicted", aligned)):
        shown = root * display_signs(exact.eigenvectors) * vectors
        error = np.abs(page.modes(name) - shown[order]).max(axis=0)
        scale = np.array(page.facts["colours"]["scale"])
        assert (error <= scale / 65534 * 1.001).all()
        assert (error / scale).max() <= written.quantisation * 1.001
    assert 0 < written.quantisation <= 1 / 65534
    assert (written.n_points, written.n_shown, written.n_modes) == (mesh.n, mesh.n, 8)
    assert not written.decimated
    assert written.bytes == len(pages[1])
    low, side = mesh.points.min(axis=0), np.ptp(mesh.points, axis=0).max()
    unit = (mesh.points - low) / side
    np.testing.assert_allclose(page.points(), unit[order], atol=0.5001 / 65535)
    # The same triangles with the same sides up, whatever their order and first corner.
    theirs, ours = (
        {tuple(np.roll(face, -face.argmin())) for face in faces}
        for faces in (order[page.faces()], mesh.faces)
    )
    assert theirs == ours


def test_the_page_of_a_cloud_holds_the_triangles_of_its_nodal_lines(mesh, exact, tmp_path):
    cloud = mesh.as_cloud()
    page = Page(write_explorer(tmp_path / "page.html", cloud, exact).path)
    f, data = page.facts["stars"], page.blocks["geometry"][12 * cloud.n :]
    first, second, third = (numbers32(data[4 * f * i :], f) for i in range(3))
    rows = walk(cloud)[np.column_stack([first, first + second, first + third])]
    theirs = np.unique(np.sort(rows, axis=1), axis=0)
    ours = np.unique(np.sort(triangles_of(cloud), axis=1), axis=0)
    np.testing.assert_array_equal(theirs, ours)
    assert page.facts["diameter"] == ball_diameter(cloud) / np.ptp(cloud.points, axis=0).max()
    assert "stars" not in Page(write_explorer(tmp_path / "mesh.html", mesh, exact).path).facts


def test_numbers_on_the_page_are_those_of_the_comparison(mesh, exact, predicted, tmp_path):
    comparison = compare_spectra(exact, predicted, k=6)
    page = Page(
        write_explorer(tmp_path / "page.html", mesh, exact, predicted, comparison=comparison).path
    )
    facts = page.facts
    assert len(facts["exact"]["eigenvalues"]) == 6
    assert facts["comparison"]["partner"][:3] == [0, 2, 1]
    np.testing.assert_allclose(
        facts["predicted"]["eigenvalues"], comparison.predicted_eigenvalues, rtol=1e-6
    )
    signed = comparison.predicted_eigenvalues[1:] / comparison.eigenvalues[1:] - 1
    assert facts["comparison"]["eigenvalue_error"][0] is None
    np.testing.assert_allclose(facts["comparison"]["eigenvalue_error"][1:], signed, rtol=1e-5)
    np.testing.assert_allclose(
        facts["exact"]["residuals"], exact.certificate.residuals[:6], rtol=1e-6
    )
    assert facts["predicted"]["residuals"] is None
    np.testing.assert_allclose(facts["exact"]["errors"], exact.certificate.errors[:6], rtol=1e-6)
    assert facts["exact"]["bounded"] == [True] * 6
    assert facts["predicted"]["errors"] is None
    assert facts["area"] == pytest.approx(exact.area)
    assert facts["boundary"] == 0
    assert facts["first"] == 1


def test_limits_are_symmetric_and_shared(mesh, exact, predicted, tmp_path):
    page = Page(write_explorer(tmp_path / "page.html", mesh, exact, predicted).path)
    pair = np.sqrt(exact.area) * np.stack([exact.eigenvectors, align_modes(exact, predicted)])
    limit = np.percentile(np.abs(pair), 99, axis=1)
    np.testing.assert_allclose(page.facts["colours"]["limit"], limit.max(axis=0), rtol=1e-6)
    same = Page(write_explorer(tmp_path / "same.html", mesh, exact, exact).path)
    assert all(same.facts["colours"]["hidden"])  # differences too small for the page
    assert all(value > 0 for value in same.facts["colours"]["difference"])
    difference = np.percentile(np.abs(pair[1] - pair[0]), 99, axis=0)
    np.testing.assert_allclose(page.facts["colours"]["difference"], difference, rtol=1e-6)
    palette = np.frombuffer(base64.b64decode(page.facts["palette"]), np.uint8).reshape(256, 3)
    assert palette[128].min() > 235  # white at zero
    assert palette[20, 2] > palette[20, 0] + 60  # blue below
    assert palette[-20, 0] > palette[-20, 2] + 60  # red above


def test_a_mode_costs_less_than_two_bytes_a_point(tmp_path):
    ball = sphere(subdivisions=4).geometry
    values = np.cos(3 * ball.points @ np.random.default_rng(0).normal(size=(3, 20)))
    vectors, _ = np.linalg.qr(values)
    spectrum = Spectrum(np.arange(20.0), vectors, np.ones(ball.n))
    written = write_explorer(tmp_path / "page.html", ball, spectrum)
    empty = len((PACKAGE / "assets" / "explorer.js").read_bytes())
    assert written.bytes - empty < 20 * ball.n * 2 * (4 / 3) + 60_000


def test_what_is_approximate_is_not_called_exact(tmp_path):
    """With estimates of its errors, or so far off that there are none."""
    laplacian = robust_laplacian(bumpy())
    subspace = GivenBasis(np.column_stack([np.ones(laplacian.n), bumpy().points]))
    approximate = (Cascade(coarsest=150), RayleighRitz(subspace=subspace))
    for solver, name in ((Arpack(), "exact"), *((solver, "approximate") for solver in approximate)):
        spectrum = eigensolve(laplacian, 4, solver)
        page = Page(write_explorer(tmp_path / "page.html", bumpy(), spectrum).path)
        assert page.facts["names"] == [name, "predicted"]


@pytest.mark.parametrize("name", ["<script>alert(1)</script> & b", "Häschen “兎” %%FACTS%%"])
def test_names_are_text_and_nothing_else(mesh, exact, predicted, tmp_path, name):
    path = tmp_path / "page.html"
    write_explorer(path, mesh, exact, predicted, names=(name, name), title=name)
    page = Page(path)
    assert page.facts["title"] == name
    assert page.facts["names"] == [name, name]
    scripts = re.findall(r"<script[^>]*>", page.text)
    assert len(scripts) == 5  # facts, three blocks of data, the program
    assert "alert(1)</script>" not in page.text
    assert page.text.count('id="facts"') == 1


def test_the_page_may_load_nothing(mesh, exact, tmp_path):
    text = write_explorer(tmp_path / "page.html", mesh, exact).path.read_text("utf-8")
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)[1]
    assert policy.startswith("default-src 'none';")
    script = text[text.rindex("<script>") + 8 : text.rindex("</script>")]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"'sha256-{digest}'" in policy
    assert not re.search(r'(src|href)="(?!data:)', text.replace(script, ""))


def test_a_large_mesh_is_decimated_and_keeps_its_modes(tmp_path):
    sheet = rectangle(n=3000)
    coarse, carry = for_display(sheet.geometry, 1000)
    assert 800 <= coarse.n <= 1000
    np.testing.assert_allclose(carry.sum(axis=1), 1.0)
    x, y = (coarse.points[:, i] for i in range(2))
    width, height = np.ptp(sheet.geometry.points[:, :2], axis=0)
    true = np.cos(2 * np.pi * x / width) * np.cos(np.pi * y / height)
    fx, fy = (sheet.geometry.points[:, i] for i in range(2))
    carried = carry @ (np.cos(2 * np.pi * fx / width) * np.cos(np.pi * fy / height))
    assert np.abs(carried - true).max() < 5e-3  # h^2 of the full mesh
    n = sheet.geometry.n
    spectrum = Spectrum(np.zeros(1), np.full((n, 1), 0.01), np.ones(n))
    written = write_explorer(tmp_path / "page.html", sheet.geometry, spectrum, max_points=1000)
    facts = Page(written.path).facts
    assert written.decimated
    assert facts["decimated"]
    counts = (n, coarse.n)
    assert (written.n_points, written.n_shown) == (facts["points"], facts["shown"]) == counts
    tiny = TriangleMesh(1e-3 * (ball := sphere(subdivisions=4).geometry).points + 5, ball.faces)
    far = for_display(tiny, 600)[0].points  # where neither scale nor place is near one
    assert np.abs(np.linalg.norm((far - 5) / 1e-3, axis=1) - 1).max() < 0.02


def test_a_large_cloud_is_thinned_evenly():
    rng = np.random.default_rng(0)
    dense = np.vstack([rng.random((9000, 3)), 0.1 * rng.random((9000, 3))])  # one corner crowded
    coarse, carry = for_display(PointCloud(dense), 2000)
    assert 1800 <= coarse.n <= 2000
    corner = (coarse.points < 0.1).all(axis=1).mean()
    assert corner < 0.02  # half of all points lay there
    np.testing.assert_array_equal(carry @ dense, coarse.points)


def degenerate() -> TriangleMesh:
    """Two components, a triangle without area, a lone vertex."""
    points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 0, 0], [6, 0, 0], [5, 1, 0], [9, 9, 9]]
    return TriangleMesh(points, [[0, 1, 2], [3, 4, 5], [3, 3, 4]])


@pytest.mark.parametrize(
    "geometry",
    [
        degenerate(),
        PointCloud([[0.0, 0, 0]]),
        PointCloud(np.zeros((5, 3))),
        PointCloud(np.random.default_rng(0).random((40, 3))),
        TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]),
    ],
    ids=["dirty mesh", "one point", "equal points", "cloud", "triangle"],
)
def test_odd_geometries_and_one_mode(geometry, tmp_path):
    spectrum = Spectrum(np.zeros(1), -np.ones((geometry.n, 1)), np.ones(geometry.n))
    page = Page(write_explorer(tmp_path / "page.html", geometry, spectrum).path)
    # Shown as 1, whatever the sign it came with.
    np.testing.assert_allclose(page.modes("exact"), np.sqrt(geometry.n), rtol=1e-4)
    assert page.facts["first"] == 0
    if isinstance(geometry, TriangleMesh):
        assert len(page.faces()) == len(geometry.faces)


def test_modes_held_at_a_boundary_and_spectra_of_other_lengths(tmp_path):
    sheet = rectangle(n=200)
    free = robust_laplacian(sheet.geometry)
    held = free.dirichlet(sheet.geometry.boundary_vertices)
    long, short = eigensolve(held, 6), eigensolve(held, 4)
    written = write_explorer(tmp_path / "page.html", sheet.geometry, long, short)
    assert written.n_modes == 4
    facts = Page(written.path).facts
    assert facts["first"] == 0  # no mode is constant
    around = 2 * np.ptp(sheet.geometry.points, axis=0).sum()
    assert facts["boundary"] == pytest.approx(-around)
    loose = eigensolve(free, 4)
    assert free_boundary(sheet.geometry, loose) == pytest.approx(around)
    assert free_boundary(sheet.geometry.as_cloud(), loose) == 0


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"path": "page.txt"}, r"`path` must end in \.html, got 'page\.txt'"),
        ({"path": "nowhere/page.html"}, r"the folder .* does not exist"),
        ({"geometry": SMALL}, "`geometry` must have the 642 points of the spectrum, got 42"),
        ({"exact": lambda e: e.truncate(1).nonzero()}, "`exact` must have at least one mode"),
        ({"predicted": None, "comparison": compare_spectra}, "pass `predicted` as well"),
        (
            {"exact": lambda e: e.truncate(4), "comparison": compare_spectra},
            "`comparison` must be of these spectra of 4 and 8 modes",
        ),
        (
            {"predicted": Spectrum(np.zeros(1), np.ones((2, 1)), np.ones(2))},
            "`predicted` must live on the 642 points",
        ),
    ],
)
def test_what_cannot_be_shown_is_refused(
    mesh, exact, predicted, tmp_path, monkeypatch, changed, message
):
    monkeypatch.chdir(tmp_path)
    if "comparison" in changed:
        changed = changed | {"comparison": compare_spectra(exact, predicted)}
    if "exact" in changed:
        changed = changed | {"exact": changed["exact"](exact)}
    good = {"path": "page.html", "geometry": mesh, "exact": exact, "predicted": predicted}
    with pytest.raises(InvalidInputError, match=message):
        write_explorer(**good | changed)
    assert not list(tmp_path.iterdir())


def test_the_program_was_built_from_its_sources():
    web = PACKAGE / "web"
    if not web.is_dir():
        pytest.skip("an installed package carries the program alone")
    names = ["build.mjs", "package-lock.json"]
    names += sorted(f"src/{source.name}" for source in (web / "src").glob("*.js"))
    digest = hashlib.sha256(b"".join((web / name).read_bytes() for name in names)).hexdigest()
    head = (PACKAGE / "assets" / "explorer.js").read_text("utf-8")[:2000]
    assert f"sources sha256: {digest}\n" in head, "run `npm ci && npm run build` in explorer/web"
    assert "The MIT License" in head
    assert "three.js authors" in head
