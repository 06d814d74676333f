"""A store of spectra: what it keeps, under which keys, and what becomes of damage."""

import errno
import json
import os
import shutil
import stat
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import bumpy, creature, refused

import spectra_kit as sk
from spectra_kit._core.fingerprint import facts_digest
from spectra_kit.datasets import Plan, SpectrumStore, complete
from spectra_kit.datasets import files as store_files
from spectra_kit.errors import (
    DamagedEntryWarning,
    InvalidFileError,
    StoreError,
)
from spectra_kit.geometry import PointCloud, TriangleMesh, write
from spectra_kit.neo import NeoConfig, NeoNetwork, save_weights
from spectra_kit.operators import tangent_gradient

PLAN = Plan(k=12)


@pytest.fixture
def store(tmp_path):
    return SpectrumStore(tmp_path / "store")


def content(folder):
    """The bytes of every file of a folder."""
    files = (path for path in Path(folder).rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


@contextmanager
def unprivileged():
    """Be nobody for a while, if this is the superuser, who may write anywhere."""
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)
    try:
        yield
    finally:
        if root:
            os.seteuid(0)


def test_a_repair_leaves_nan_points_out(tmp_path):
    ball = bumpy()
    points = ball.points.copy()
    points[5] = np.nan
    rows = [f"v {x} {y} {z}" for x, y, z in points.tolist()]
    rows += [f"f {a} {b} {c}" for a, b, c in (ball.faces + 1).tolist()]
    (tmp_path / "scan.obj").write_text("\n".join(rows))
    store = SpectrumStore(tmp_path / "store")
    with pytest.raises(InvalidFileError, match="without_nan"):
        complete(store, "scan", tmp_path / "scan.obj", Plan(k=5))
    kept = complete(store, "scan", tmp_path / "scan.obj", Plan(k=5, repair=True))
    assert kept.record.points == ball.n - 1


def test_records_tell_what_was_passed_over_and_of_clouds_in_parts(tmp_path):
    ball = bumpy()
    write(ball, tmp_path / "ball.obj")
    with (tmp_path / "ball.obj").open("a") as file:
        file.write("l 1 2\n")
    turn = np.linspace(0, 2 * np.pi, 100, endpoint=False)
    ring = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(100)])
    write(PointCloud(np.concatenate([ring, ring + [0, 0, 1]])), tmp_path / "rings.xyz")
    store, plan = SpectrumStore(tmp_path / "store"), Plan(k=5, operator="knn")
    for _ in range(2):  # what is known is told again
        record = complete(store, "ball", tmp_path / "ball.obj", Plan(k=5)).record
        assert record.problems[0].startswith("passed over 1 line")
        record = complete(store, "rings", tmp_path / "rings.xyz", plan).record
        assert record.warnings[0].startswith("the cloud falls into 2 parts")


def test_what_comes_back_is_what_was_solved(store):
    mesh = bumpy()
    exact = sk.eigensolve(sk.laplacian(mesh), 12)
    first, second = store.spectrum(mesh, PLAN), store.spectrum(mesh, PLAN)
    loaded = store.load(store.key(mesh, PLAN), mmap=True)
    for kept in (first, second, loaded):
        np.testing.assert_array_equal(kept.eigenvalues, exact.eigenvalues)
        np.testing.assert_array_equal(kept.eigenvectors, exact.eigenvectors)
        np.testing.assert_array_equal(kept.mass, exact.mass)
        assert kept.certificate.level == exact.certificate.level
        assert kept.provenance.solver == exact.provenance.solver
        assert kept.provenance.seconds == {}
    assert isinstance(loaded.eigenvectors.base.base, np.memmap)
    assert [entry.kind for entry in store.entries()] == ["shapes", "spectra"]


def test_a_second_call_writes_nothing(store):
    store.descriptor(bumpy(), PLAN, "hks")
    before = {entry.path: entry.path.stat().st_mtime_ns for entry in store.entries()}
    store.descriptor(bumpy(), PLAN, "hks")
    assert before == {entry.path: entry.path.stat().st_mtime_ns for entry in store.entries()}


def test_keys_tell_all_that_decides_a_spectrum_and_nothing_else(store):
    mesh = bumpy()
    nudged = np.array(mesh.points)
    nudged[7, 1] = np.nextafter(nudged[7, 1], 9)
    others = [
        (TriangleMesh(nudged, mesh.faces), PLAN),
        (TriangleMesh(mesh.points, mesh.faces[:, [1, 2, 0]]), PLAN),
        (mesh.as_cloud(), PLAN),
        *((mesh, plan) for plan in (
            Plan(k=13), Plan(k=12, solver=sk.Arpack()), Plan(k=12, solver=sk.Arpack(seed=1)),
            Plan(k=12, operator="cotan"), Plan(k=12, operator="robust"),
            Plan(k=12, boundary="dirichlet"), Plan(k=12, precision="float32"),
        )),
    ]  # fmt: skip
    keys = {store.key(shape, plan) for shape, plan in [(mesh, PLAN), *others]}
    assert len(keys) == len(others) + 1
    same = Plan(k=12, descriptors=("hks",), repair=True, cloud=50, seed=3)
    copy = TriangleMesh(np.array(mesh.points), np.array(mesh.faces))
    assert store.key(copy, same) == store.key(mesh, PLAN)


def test_weights_that_changed_in_their_file_are_others(store, tmp_path):
    config = NeoConfig(width=16, depth=1, heads=2, head_width=8, latents=4, m=16, k=8)
    path, keys = tmp_path / "mine.safetensors", set()
    for seed in (0, 1):
        torch.manual_seed(seed)
        save_weights(path, NeoNetwork(config), {})
        keys.add(store.key(bumpy(), Plan(k=8, solver=sk.Neo(weights=str(path)))))
    assert len(keys) == 2


def test_float32_keeps_eigenvalues_and_masses_whole(store):
    exact, plan = store.spectrum(bumpy(), PLAN), Plan(k=12, precision="float32")
    made, again = (store.spectrum(bumpy(), plan) for _ in range(2))
    np.testing.assert_array_equal(made.eigenvalues, exact.eigenvalues)
    np.testing.assert_array_equal(made.mass, exact.mass)
    rounded = exact.eigenvectors.astype(np.float32)
    for kept in (made, again):
        np.testing.assert_array_equal(kept.eigenvectors, rounded)
    with np.load(store._place("spectra", store.key(bumpy(), plan))) as file:
        assert file["eigenvectors"].dtype == np.float32


@pytest.mark.parametrize("name", sk.features.DESCRIPTORS)
def test_descriptors_are_those_of_the_features(store, name):
    mesh = bumpy()
    expected = sk.features.DESCRIPTORS[name](store.spectrum(mesh, PLAN))
    for _ in range(2):
        np.testing.assert_array_equal(store.descriptor(mesh, PLAN, name), expected)


def test_operators_are_those_that_are_assembled(store):
    mesh, gradient = bumpy(), tangent_gradient(bumpy(), oriented=True)
    for precision, tolerance in (("float64", 0.0), ("float32", 1e-6)):
        plan = Plan(k=12, operator="cotan", precision=precision)
        stiffness = store.load_operator(store.keep_operator(mesh, plan, "stiffness"))
        frames, x, y = store.load_operator(store.keep_operator(mesh, plan, "gradient"))
        assert stiffness.dtype == x.dtype == frames.dtype == precision
        for kept, made in ((stiffness, sk.cotan_laplacian(mesh).stiffness), (x, gradient.x),
                           (y, gradient.y)):  # fmt: skip
            assert abs(kept - made).max() <= tolerance * abs(made).max()
        np.testing.assert_allclose(frames, gradient.frames, atol=tolerance)
    assert len(list(store.entries("operators"))) == 4


def test_entries_are_for_numpy_alone_to_read(store):
    key = store.key(bumpy(), PLAN)
    store.spectrum(bumpy(), PLAN)
    entry = next(store.entries("spectra"))
    assert (entry.key, entry.path.parent.name) == (key, key[:2])
    with np.load(entry.path) as file:
        assert file["eigenvectors"].shape == (bumpy().n, 12)
    with np.load(next(store.entries("shapes")).path) as file:
        np.testing.assert_array_equal(file["points"], bumpy().points)
        np.testing.assert_array_equal(file["faces"], bumpy().faces)


# --- damage ---


def cut(data):
    return data[: len(data) // 2]


def flip(data):
    middle = len(data) // 2  # in the arrays, of small entries too
    return data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]


FULL = Plan(k=12, descriptors=("hks", "dna"), operators=("stiffness", "gradient"))


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    """A folder with a file, and a store with its shape, two descriptors and a record."""
    folder = tmp_path_factory.mktemp("original")
    write(bumpy(), folder / "bumpy.off")
    complete(SpectrumStore(folder / "store"), "bumpy", folder / "bumpy.off", FULL)
    return folder


@pytest.fixture
def filled(tmp_path, original):
    """A copy of that store, the test's own, and what completes it again."""
    shutil.copytree(original, tmp_path, dirs_exist_ok=True)
    store = SpectrumStore(tmp_path / "store")
    return store, lambda: complete(store, "bumpy", tmp_path / "bumpy.off", FULL)


@pytest.mark.parametrize("damage", [cut, flip])
@pytest.mark.parametrize("kind", ["shapes", "spectra", "descriptors", "operators", "records"])
def test_damage_is_named_and_made_good(filled, kind, damage):
    store, again = filled
    before = content(store.path)
    entry = next(store.entries(kind))
    if kind == "records" and damage is flip:
        text = entry.path.read_text().replace('"bumpy"', '"Bumpy"')  # whole JSON of another name
        entry.path.write_text(text)
    else:
        entry.path.write_bytes(damage(entry.path.read_bytes()))
    found = store.verify()
    assert [one.path for one in found] == [entry.path]
    if damage is flip:  # which its size does not tell
        store.verify(remove=True)
        assert not entry.path.exists()
    done = again()
    if kind != "records" and damage is not flip:
        assert [str(entry.path) in text for text in done.replaced] == [True]
    assert done.computed == (kind == "spectra")
    assert content(store.path) == before
    assert store.verify() == []


RECORDS = {
    "a digit of an eigenvalue": ('"eigenvalues": [0.', '"eigenvalues": [9.'),
    "a key": ('"spectrum": "', '"spectrum": "0'),
    "a field": ('"area"', '"arez"'),
    "the checksum's name": ('"sha256"', '"sha255"'),
    "no object": ("{", "[{"),
}


@pytest.mark.parametrize(("old", "new"), RECORDS.values(), ids=RECORDS)
def test_one_bad_record_stops_nothing(filled, old, new):
    """It is made again by a run, left out by lists, named and taken out by `verify`."""
    store, again = filled
    path, before = next(store.entries("records")).path, content(store.path)
    assert old in path.read_text()
    bad = path.read_text().replace(old, new, 1)
    path.write_text(bad)
    with pytest.warns(DamagedEntryWarning, match=f"{path} is damaged and left out"):
        assert list(store.records()) == []
    with pytest.warns(DamagedEntryWarning, match="left out"):
        assert store.clean() == []
    with pytest.raises(InvalidFileError, match=str(path)):  # nobody knows what it has named
        store.clean(unnamed=True)
    done = again()
    assert [str(path) in text for text in done.replaced] == [True]
    assert (done.computed, content(store.path)) == (False, before)
    path.write_text(bad)
    assert [one.path for one in store.verify(remove=True)] == [path]
    assert store.verify() == []
    assert again().record == next(store.records())


def test_records_of_an_earlier_release_have_no_checksum(filled):
    store, again = filled
    path = next(store.entries("records")).path
    bare = json.loads(path.read_text())
    del bare["sha256"]
    path.write_text(json.dumps(bare))
    assert len(store.verify()) == 1  # this release writes none without
    again()
    bare["facts"]["release"] = "0.1.0"
    key = facts_digest(store_files.record_facts(bare["name"], bare["facts"]))
    old = path.parents[1] / key[:2] / f"{key}.json"
    old.parent.mkdir(exist_ok=True)
    old.write_text(json.dumps(bare))
    assert store.verify() == []
    assert len(list(store.records())) == 2
    assert store.clean() == [old]


@pytest.mark.parametrize("kind", store_files.SUFFIX)
def test_the_entry_of_one_under_the_name_of_another_is_not_handed_out(filled, tmp_path, kind):
    store, _ = filled
    plan = Plan(k=12, descriptors=("hks",), operators=("stiffness",))
    write(creature(600), tmp_path / "other.off")
    spectra = [
        complete(store, name, tmp_path / f"{name}.off", plan).record.spectrum
        for name in ("bumpy", "other")
    ]
    for ends in (spectra, spectra[::-1]):
        store.keep_map(*ends, {"k": 12}, {"point_map": np.arange(3)})
    one, two = [*store.entries(kind)][:2]
    before = content(store.path)
    one.path.write_bytes(two.path.read_bytes())
    loading = {
        "shapes": store.shape,
        "spectra": store.load,
        "descriptors": store.load_descriptor,
        "operators": store.load_operator,
        "maps": store.load_map,
        "records": lambda _: store_files.read_record(one.path),
    }
    with pytest.raises(InvalidFileError, match="has another hash than its name"):
        loading[kind](one.key)
    told = []
    found = store.verify(progress=lambda done, count: told.append((done, count)))
    assert [damage.path for damage in found] == [one.path]
    assert told[-1] == (len(told), len(told))
    if kind == "spectra":
        shapes = [store.shape(entry.key) for entry in store.entries("shapes")]
        with pytest.warns(DamagedEntryWarning, match=one.key):
            values = [store.spectrum(shape, plan).eigenvalues for shape in shapes]
        for shape, found in zip(shapes, values, strict=True):
            np.testing.assert_allclose(found, sk.spectrum(shape, 12).eigenvalues, atol=1e-9)
        assert content(store.path) == before


# --- what nobody needs any more ---


def aged(path):
    """Let a file be two days old."""
    then = time.time() - 48 * 3600
    os.utime(path, (then, then))


def test_clean_removes_what_belongs_to_no_name_if_asked(store, tmp_path):
    path = tmp_path / "a.off"
    for seed in range(3):
        write(creature(520, seed=seed), path)
        complete(store, "a", path, Plan(k=5, descriptors=("hks",), operators=("stiffness",)))
    for entry in store.entries():
        aged(entry.path)
    assert store.clean() == []
    assert len(store.clean(unnamed=True)) == 2 * 4  # shape, spectrum, descriptor, operator
    assert not complete(store, "a", path, Plan(k=5, descriptors=("hks",), operators=("stiffness",)
                                               )).computed  # fmt: skip
    assert store.verify() == []


class Cleaning(sk.Arpack):
    """A solver beside which somebody else cleans the store."""

    def eigenpairs(self, laplacian, k):
        for entry in STORES[-1].entries("shapes"):
            aged(entry.path)  # as if it took two days
        STORES[-1].clean()
        return super().eigenpairs(laplacian, k)


STORES = []


def test_a_store_that_is_cleaned_beside_a_run_keeps_what_the_run_needs(store, tmp_path):
    STORES.append(store)
    write(bumpy(), tmp_path / "a.off")
    done = complete(store, "a", tmp_path / "a.off", Plan(k=5, solver=Cleaning()))
    assert store.holds(done.record)
    np.testing.assert_array_equal(store.shape(done.record.shape).points, bumpy().points)


@pytest.mark.parametrize("kind", ["shapes", "spectra", "descriptors", "operators"])
def test_what_is_gone_is_made_again(filled, kind):
    store, again = filled
    before = content(store.path)
    next(store.entries(kind)).path.unlink()
    assert again().computed == (kind == "spectra")
    assert content(store.path) == before


def test_clean_beside_a_run_takes_nothing_new_and_misses_nothing_gone(filled, monkeypatch):
    store, _ = filled
    read, gone = store_files.read, []

    def meanwhile(path, **options):
        if path.parent.parent.name == "operators" and not gone:  # spectra are looked at
            store.descriptor(creature(520), PLAN, "hks")
            gone.append(path)
            path.unlink()
        return read(path, **options)

    monkeypatch.setattr(store_files, "read", meanwhile)
    assert store.clean() == []
    assert len(gone) == 1
    path = store._place("descriptors", store.descriptor_key(
        store.key(creature(520), PLAN), "hks"))  # fmt: skip
    assert path.exists()


def test_what_others_take_out_is_no_damage(filled):
    store, _ = filled
    *_, last = store.entries()
    assert last.kind == "records"
    spectrum = next(store.entries("spectra"))

    def take(done, count):
        spectrum.path.unlink(missing_ok=True)
        last.path.unlink(missing_ok=True)

    assert store.verify(progress=take) == []


@pytest.mark.parametrize("calls", ["clean", "verify"])
def test_what_cannot_be_read_for_a_moment_is_not_gone(filled, monkeypatch, calls):
    """From Python 3.14 on, `Path.exists` says that it is."""
    store, _ = filled
    before, lost = content(store.path), next(store.entries("spectra")).path
    stat, read, away = Path.stat, store_files.read, []

    def stale(path, **options):
        if path in away:
            raise OSError(errno.ESTALE, "stale file handle", str(path))
        return stat(path, **options)

    def unread(path, **options):
        if path != lost:
            return read(path, **options)
        away.append(lost)  # after it was listed
        raise InvalidFileError(path, "cannot be read")

    monkeypatch.setattr(Path, "stat", stale)
    monkeypatch.setattr(Path, "exists", lambda path: path not in away and os.path.exists(path))
    monkeypatch.setattr(store_files, "read", unread)
    with pytest.raises(OSError, match="stale"):
        getattr(store, calls)()
    monkeypatch.undo()
    assert content(store.path) == before


@pytest.mark.parametrize("ahead", [-1e6, 1e6])
def test_clean_goes_by_the_clock_of_the_files(store, monkeypatch, ahead):
    """Another machine's may be days off."""
    store.keep_shape(creature(600))
    monkeypatch.setattr(time, "time", lambda: ahead + 1.8e9)
    assert store.clean() == []
    path = next(store.entries("shapes")).path
    then = path.stat().st_mtime - 48 * 3600
    os.utime(path, (then, then))
    assert store.clean() == [path]


def test_clean_removes_other_releases_orphans_and_leftovers(filled, monkeypatch):
    store, _ = filled
    kept = {entry.path for entry in store.entries()}
    with monkeypatch.context() as other:
        other.setattr("spectra_kit.datasets.plan.VERSION", "0.0.1")
        plan = Plan(k=5, descriptors=("hks",), operators=("stiffness",))
        store.descriptor(creature(600), plan, "hks")
        write(creature(600), store.path / "old.off")
        complete(store, "old", store.path / "old.off", plan)
    old = next(store.entries("shapes")).path.parent / ".0123456789abcdef.npz"
    young = old.with_name(".fedcba9876543210.npz")
    for path in (old, young):
        path.write_bytes(b"half")
    aged(old)
    gone = store.clean()
    assert old in gone
    assert len(gone) == 5  # spectrum, descriptor, operator, record, what a writer has left
    orphan = next(entry.path for entry in store.entries("shapes") if entry.path not in kept)
    aged(orphan)  # of the last day it might be one that a run has kept and is solving for
    assert store.clean() == [orphan]
    assert {entry.path for entry in store.entries()} == kept
    assert young.exists()


# --- places that are no good ---


def test_a_store_of_a_newer_release_is_refused_and_stays(store):
    store.spectrum(bumpy(), PLAN)
    mark = store.path / "store.json"
    mark.write_text(json.dumps({"format": "spectra_kit store", "version": 2}))
    before = content(store.path)
    with pytest.raises(InvalidFileError, match="version 2, this spectra_kit reads up to 1; upgr"):
        SpectrumStore(store.path)
    assert content(store.path) == before


@pytest.mark.parametrize("text", ["{", '{"format": "other", "version": 1}', "[]", ""])
def test_a_mark_that_is_damaged(store, text):
    (store.path / "store.json").write_text(text)
    with pytest.raises(InvalidFileError, match="not a whole mark of a store"):
        SpectrumStore(store.path)


def test_other_things_are_no_stores(tmp_path):
    (tmp_path / "file").write_text("words")
    for path in (tmp_path, tmp_path / "file"):
        refused("path", "be a store, an empty folder or a new one", SpectrumStore, path)
    assert (tmp_path / "file").read_text() == "words"
    with pytest.raises(StoreError, match="not a directory"):
        SpectrumStore("/dev/null/store")


def test_many_may_make_a_store_at_once(tmp_path):
    def made(name):
        return SpectrumStore(tmp_path / name).keep_shape(bumpy())

    with ThreadPoolExecutor(8) as pool:
        keys = list(pool.map(made, [f"{i // 8}" for i in range(320)]))
    assert len(set(keys)) == 1
    (tmp_path / "left").mkdir()
    (tmp_path / "left" / ".0123456789abcdef.json").write_text("{")  # of one that was killed
    assert made("left") == keys[0]


def test_a_full_disk_leaves_nothing_half(store):
    resource = pytest.importorskip("resource", reason="limits of files are Unix's")
    store.spectrum(bumpy(), PLAN)
    before, (_, hard) = content(store.path), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
    try:
        with pytest.raises(StoreError, match=r"cannot write .*\.npz: .*; what is there stays"):
            store.spectrum(creature(600), PLAN)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
    assert content(store.path) == before
    assert store.spectrum(creature(600), PLAN).k == 12


def test_a_store_that_may_only_be_read():
    with tempfile.TemporaryDirectory() as folder:
        os.chmod(folder, 0o755)
        store = SpectrumStore(Path(folder) / "store")
        write(bumpy(), Path(folder) / "bumpy.off")
        complete(store, "bumpy", Path(folder) / "bumpy.off", PLAN)
        before, places = content(store.path), [store.path, *store.path.rglob("*")]
        for place in places:
            place.chmod(stat.S_IMODE(place.stat().st_mode) & ~0o222)
        with unprivileged():
            again = SpectrumStore(store.path)
            assert again.spectrum(bumpy(), PLAN).k == 12
            assert not complete(again, "bumpy", Path(folder) / "bumpy.off", PLAN).computed
            with pytest.raises(StoreError, match="permission denied"):
                again.spectrum(creature(600), PLAN)
        assert content(store.path) == before
        for place in places:
            place.chmod(0o755)
