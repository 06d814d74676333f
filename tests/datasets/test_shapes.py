"""Many shapes into a store: results beside failures, once each; tables; shapes that go together."""

import csv
import json
import os
import subprocess
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from conftest import bumpy, creature, joined, moved, refused

import spectra_kit as sk
from spectra_kit._core.fingerprint import BLANK, sealed
from spectra_kit._core.threads import single_threaded
from spectra_kit._sparse.memory import memory_of
from spectra_kit.datasets import (
    Input,
    Plan,
    SpectrumStore,
    complete,
    compute_all,
    find_inputs,
    write_distances,
    write_table,
)
from spectra_kit.datasets.shapes import begin, known
from spectra_kit.datasets.table import check_columns
from spectra_kit.datasets.table import write as write_rows
from spectra_kit.errors import (
    InvalidFileError,
    OutOfMemoryError,
    SpectraKitError,
    SplitSurfaceWarning,
    StoreError,
)
from spectra_kit.geometry import PointCloud, TriangleMesh, rectangle, write

PLAN = Plan(k=6)


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    """Four shapes, of which two are one; and three files that are none."""
    folder = tmp_path_factory.mktemp("scans")
    for i in range(2):
        write(creature(520, seed=i), folder / f"animal{i}.off")
    write(moved(bumpy(), 3, 0, 0), folder / "bumpy.ply")
    write(moved(bumpy(), 3, 0, 0), folder / "copy.ply")
    (folder / "empty.off").touch()
    (folder / "half.off").write_text("OFF\n4 4 0\n0 0 0\n")
    (folder / "words.obj").write_text("these are words\n")
    return folder


@pytest.fixture
def store(tmp_path):
    return SpectrumStore(tmp_path / "store")


def content(folder):
    """The bytes of every file of a folder."""
    files = (path for path in Path(folder).rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def test_results_and_failures_are_in_the_order_of_the_inputs(scans, store):
    told = []
    inputs = find_inputs([scans])
    report = compute_all(inputs, store, PLAN, progress=lambda *args: told.append(args))
    assert told == [(i + 1, 7) for i in range(7)]
    assert [one.path.name for one, _ in report.completed] == [
        *("animal0.off", "animal1.off", "bumpy.ply", "copy.ply")
    ]
    reasons = {one.input.path.name: str(one.error) for one in report.failed}
    assert [*reasons] == ["empty.off", "half.off", "words.obj"]
    assert "the file is empty" in reasons["empty.off"]
    assert all(name in reason for name, reason in reasons.items())
    assert report.computed == 3  # of two names of one shape, one is solved for
    assert report.replaced == ()
    for one, done in report.completed:
        expected = sk.spectrum(one.path, 6)
        np.testing.assert_allclose(
            done.record.eigenvalues, expected.eigenvalues, rtol=1e-12, atol=1e-12
        )
        assert done.record.area == pytest.approx(sk.read(one.path).area)


def test_a_second_run_computes_nothing_and_writes_nothing(scans, store):
    inputs = find_inputs([scans])
    compute_all(inputs, store, PLAN)
    before = {entry.path: entry.path.stat().st_mtime_ns for entry in store.entries()}
    report = compute_all(inputs, store, PLAN)
    assert (report.computed, len(report.completed), len(report.failed)) == (0, 4, 3)
    assert before == {entry.path: entry.path.stat().st_mtime_ns for entry in store.entries()}


def test_a_run_that_was_interrupted_goes_on(scans, store):
    class StoppedError(Exception):
        pass

    def stop(done, count):  # runs go each in an order of its own: broken files may be first
        if any(True for _ in store.entries("spectra")):
            raise StoppedError

    inputs = find_inputs([scans])
    with pytest.raises(StoppedError):
        compute_all(inputs, store, PLAN, progress=stop)
    there = len(list(store.entries("spectra")))
    report = compute_all(inputs, store, PLAN)
    assert there == 1
    assert report.computed == 2


def test_strict_runs_stop_at_the_first_failure(scans, store):
    with pytest.raises(InvalidFileError, match=r"empty\.off"):
        compute_all(find_inputs([scans]), store, PLAN, strict=True)


def test_a_store_that_cannot_be_written_ends_the_run(scans, store):
    (store.path / "spectra").write_text("in the way")
    with pytest.raises(StoreError, match="spectra"):
        compute_all(find_inputs([scans]), store, PLAN)


@pytest.mark.parametrize(
    ("engine", "expected"),
    [
        (lambda tasks: None, "return tasks with their results, got None"),
        (lambda tasks: [], "return all tasks with their results, got 0 of 7"),
        (lambda tasks: [(tasks[0], None)] * 2, "return the tasks that it is given, each once"),
        (lambda tasks: [(copy(tasks[0]), None)], "return the tasks that it is given, each once"),
    ],
)
def test_engines_that_are_none(scans, store, engine, expected):
    refused("engine", expected, compute_all, find_inputs([scans]), store, PLAN, engine=engine)


def test_shapes_that_go_together_have_the_modes_of_each_alone(store, tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", "2")
    plan = Plan(k=12, solver=sk.Neo())
    for i in range(2):
        write(creature(520 + 20 * i, seed=i), tmp_path / f"{i}.off")
    (tmp_path / "empty.off").touch()
    told = []
    inputs = find_inputs([str(tmp_path / "*.off")])
    report = compute_all(inputs, store, plan, progress=lambda *args: told.append(args))
    assert told == [(i + 1, 3) for i in range(3)]
    assert (report.computed, len(report.failed)) == (2, 1)
    assert [one for one, _ in report.completed] == inputs[:2]
    for one, done in report.completed:
        alone = sk.eigensolve(plan.laplacian(sk.read(one.path)), 12, sk.Neo())
        np.testing.assert_allclose(done.record.eigenvalues, alone.eigenvalues, rtol=1e-5, atol=1e-9)
    assert compute_all(inputs, store, plan).computed == 0


RUN = """
import sys, time
from pathlib import Path
import spectra_kit as sk
store, ready = sk.datasets.SpectrumStore(sys.argv[1]), Path(sys.argv[3])
inputs = sk.datasets.find_inputs([sys.argv[2]])
ready.touch()
while len([*ready.parent.glob("ready*")]) < 2:
    time.sleep(0.001)
report = sk.datasets.compute_all(inputs, store, sk.datasets.Plan(k=6))
assert [one.name for one, _ in report.completed] == [one.name for one in inputs]
print(report.computed)
"""


@pytest.mark.slow
def test_two_runs_into_one_store_share_the_work(store, tmp_path):
    (tmp_path / "scans").mkdir()
    for i in range(24):  # one body in so many sizes: another shape each, and at once made
        write(moved(bumpy(), 0, 0, 0, scale=1 + i / 100), tmp_path / "scans" / f"{i}.off")
    here = [sys.executable, "-c", RUN, str(store.path), str(tmp_path / "scans")]
    both = [
        subprocess.Popen([*here, str(tmp_path / f"ready{i}")], stdout=subprocess.PIPE, text=True)
        for i in range(2)
    ]
    computed = [int(process.communicate(timeout=120)[0]) for process in both]
    assert 24 <= sum(computed) < 33  # in one order, more than half would be computed by both
    alone = SpectrumStore(tmp_path / "alone")
    compute_all(find_inputs([tmp_path / "scans"]), alone, PLAN)
    assert content(store.path) == content(alone.path)


def test_an_engine_is_not_begun_for_what_is_there(scans, store):
    def engine(tasks):
        raise AssertionError

    inputs = find_inputs([scans / "bumpy.ply", scans / "copy.ply"])
    compute_all(inputs, store, PLAN)
    assert len(compute_all(inputs, store, PLAN, engine=engine).completed) == 2


def test_inputs_of_one_name(scans, store):
    twice = [Input(name="x", path=scans / file) for file in ("bumpy.ply", "animal0.off")]
    refused("inputs", "have names of their own, got 1", compute_all, twice, store, PLAN)


def test_cut_surfaces_are_told_by_a_fact_and_not_by_words(store, tmp_path):
    """Records of before there was this fact tell it, too."""
    ball = sk.geometry.sphere(subdivisions=1).geometry
    corners = np.arange(3 * len(ball.faces)).reshape(-1, 3)
    write(TriangleMesh(ball.points[ball.faces].reshape(-1, 3), corners), tmp_path / "cut.ply")
    write(ball, tmp_path / "whole.obj")
    inputs = find_inputs([str(tmp_path / "*.*")])
    with pytest.warns(SplitSurfaceWarning, match=r"1 shape of 2, .*cut\.ply.*Plan\(repair=True"):
        report = compute_all(inputs, store, PLAN)
    cut, whole = (done.record for _, done in report.completed)
    assert (cut.is_cut, whole.is_cut) == (True, False)
    (entry,) = (one for one in store.entries("records") if b"cut.ply" in one.path.read_bytes())
    old = json.loads(entry.path.read_text())
    del old["is_cut"]
    entry.path.write_bytes(sealed(json.dumps({**old, "sha256": BLANK}).encode()))
    assert store.record(cut.name, PLAN) == cut


# --- tables ---


def test_a_table_has_a_row_for_each_shape(scans, store, tmp_path):
    plan = Plan(k=6, descriptors=("dna",))
    found = [Input(name=path.name, path=path, columns={"age": "3"}) for path in
             (scans / "bumpy.ply", scans / "animal0.off", scans / "copy.ply")]  # fmt: skip
    report = compute_all(found, store, plan)
    write_table(tmp_path / "table.csv", report)
    with (tmp_path / "table.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["name"], row["age"], row["same_as"]) for row in rows] == [
        *(("bumpy.ply", "3", ""), ("animal0.off", "3", ""), ("copy.ply", "3", "bumpy.ply"))
    ]
    for row, (_, done) in zip(rows, report.completed, strict=True):
        values = [float(row[f"eigenvalue_{i}"]) for i in range(6)]
        np.testing.assert_array_equal(values, done.record.eigenvalues)
        signature = [float(row[f"dna_by_area_{i + 1}"]) for i in range(len(done.record.dna))]
        np.testing.assert_array_equal(signature, done.record.dna)
        assert float(row["area"]) == done.record.area
        assert store.load(row["spectrum"]).k == 6
        assert (row["components"], row["zero_modes"], row["level"]) == ("1", "1", "verified")


def test_a_table_tells_holes_handles_and_volumes(store, tmp_path):
    """Of a ball, with two holes, inside out, of a torus and a cloud; of older records, nothing."""
    ball = sk.geometry.sphere(subdivisions=2).geometry
    holed = TriangleMesh(ball.points, np.delete(ball.faces, [0, 200], axis=0))
    torus = sk.geometry.torus(n=300).geometry
    inside = TriangleMesh(ball.points, ball.faces[:, ::-1])
    shapes = {"ball": ball, "holed": holed, "inside": inside, "ring": torus}
    shapes["cloud"] = PointCloud(np.array(ball.points))
    for name, shape in shapes.items():
        write(shape, tmp_path / f"{name}.ply")
    inputs = [Input(name=name, path=tmp_path / f"{name}.ply") for name in shapes]
    report = compute_all(inputs, store, PLAN)
    write_table(tmp_path / "table.csv", report)
    with (tmp_path / "table.csv").open(newline="") as file:
        rows = {row["name"]: row for row in csv.DictReader(file)}
    told = {n: (r["boundary_edges"], r["euler_characteristic"]) for n, r in rows.items()}
    assert told == {
        **{"ball": ("0", "2"), "holed": ("6", "0"), "inside": ("0", "2")},
        **{"ring": ("0", "0"), "cloud": ("", "")},
    }
    tetrahedra = np.linalg.det(ball.points[ball.faces]).sum() / 6
    assert float(rows["ball"]["volume"]) == pytest.approx(tetrahedra)
    assert float(rows["inside"]["volume"]) == pytest.approx(-tetrahedra)
    assert float(rows["ring"]["volume"]) > 0
    assert rows["holed"]["volume"] == rows["cloud"]["volume"] == ""
    record = report.completed[0][1].record
    (entry,) = (e for e in store.entries("records") if b'"ball"' in e.path.read_bytes())
    old = json.loads(entry.path.read_text())
    for name in ("boundary_edges", "euler_characteristic", "volume"):
        del old[name]
    entry.path.write_bytes(sealed(json.dumps({**old, "sha256": BLANK}).encode()))
    assert store.record("ball", PLAN).volume is None
    assert store.record("ball", PLAN).eigenvalues == record.eigenvalues


@pytest.mark.parametrize("column", ["area", "volume", "eigenvalue_0", "dna_by_area_12"])
def test_columns_of_a_tables_own_are_refused_before_the_work(column, scans):
    check_columns([Input(name="a", path=scans, columns={"age": "3", "eigenvalue": "4"})])
    one = Input(name="a", path=scans, columns={column: "3"})
    refused("columns", "not have the names of the table's own", check_columns, [one])


@pytest.mark.parametrize(
    "text",
    ["=1+1", "+1+1", "-1+1", "@SUM(1)", "\t=1", "\r=1", "\n=1", " =1", "\uff1d1", "-", "--1",
     "-1.5x", "=cmd|'/C calc'!A0", "+49 30 123", "-1,5"],
)  # fmt: skip
def test_no_cell_is_run_by_a_spreadsheet(tmp_path, text):
    for columns, row in (([text], {text: "1"}), (["a"], {"a": text})):
        write_rows(tmp_path / "table.csv", columns, [row])
        with (tmp_path / "table.csv").open(newline="", encoding="utf-8") as file:
            cells = [cell for row in csv.reader(file) for cell in row]
        assert not any(cell.lstrip()[:1] in set("=+-@\uff1d") for cell in cells)
        assert any(text.strip() in cell for cell in cells)


@pytest.mark.parametrize("value", ["-1.5", "+3", "-.5e-3", "-2.", 7, -1.5, "cat", "", "a=b", True])
def test_numbers_and_words_stay_what_they_are(tmp_path, value):
    write_rows(tmp_path / "table.csv", ["a"], [{"a": value}])
    with (tmp_path / "table.csv").open(newline="") as file:
        assert [*csv.DictReader(file)] == [{"a": str(value)}]


def test_names_of_files_may_be_no_text(scans, store, tmp_path):
    name = os.fsdecode(b"caf\xe9.ply")
    (tmp_path / name).write_bytes((scans / "bumpy.ply").read_bytes())
    report = compute_all(find_inputs([tmp_path / name]), store, PLAN)
    write_table(tmp_path / "table.csv", report)
    assert b"caf\xe9.ply" in (tmp_path / "table.csv").read_bytes()


def test_rows_without_all_columns_have_blanks(store, tmp_path):
    """Shapes of more parts have fewer values outside the kernel; manifests have their columns."""
    ball = sk.geometry.sphere(subdivisions=1).geometry
    parts = [ball.points, ball.points + [3.0, 0, 0]], [ball.faces, ball.faces + ball.n]
    write(ball, tmp_path / "one.off")
    write(sk.TriangleMesh(*map(np.vstack, parts)), tmp_path / "two.off")
    for name, column in (("one", "age"), ("two", "sex")):
        (tmp_path / f"{name}.csv").write_text(f"file,{column}\n{name}.off,7\n")
    inputs = find_inputs([tmp_path / "one.csv", tmp_path / "two.csv"])
    report = compute_all(inputs, store, Plan(k=6, descriptors=("dna",)))
    write_table(tmp_path / "table.csv", report)
    one, two = csv.DictReader((tmp_path / "table.csv").read_text().splitlines())
    assert (one["age"], one["sex"], two["age"], two["sex"]) == ("7", "", "", "7")
    assert one["dna_by_area_5"]
    assert two["dna_by_area_4"]
    assert two["dna_by_area_5"] == ""


def test_distances_are_those_of_the_signatures_and_know_no_unit(store, tmp_path):
    animal = sk.geometry.creature(600)
    for name, scale in (("a", 1.0), ("b", 25.4)):
        write(sk.TriangleMesh(scale * animal.points, animal.faces), tmp_path / f"{name}.ply")
    write(bumpy(), tmp_path / "c.ply")
    report = compute_all(find_inputs([tmp_path]), store, Plan(k=12, descriptors=("dna",)))
    write_distances(tmp_path / "apart.csv", report)
    rows = [*csv.DictReader((tmp_path / "apart.csv").read_text().splitlines())]
    names = [one.name for one, _ in report.completed]
    apart = np.array([[float(row[name]) for name in names] for row in rows])
    spectra = [store.load(done.record.spectrum) for _, done in report.completed]
    dnas = [sk.features.shape_dna(spectrum) for spectrum in spectra]
    assert apart == pytest.approx(sk.features.shape_dna_distances(dnas), abs=1e-9)
    assert apart[0, 1] < 1e-3 * apart[0, 2]
    none = compute_all(find_inputs([tmp_path]), store, Plan(k=12))
    refused("report", "hold the ShapeDNA", write_distances, tmp_path / "none.csv", none)


def test_a_table_of_nothing(store, tmp_path):
    write_table(tmp_path / "table.csv", compute_all([], store, PLAN))
    assert (tmp_path / "table.csv").read_text().startswith("name,kind,points")


# --- plans and files ---


@pytest.mark.parametrize(
    ("argument", "expected", "options"),
    [
        ("k", "be at least 1", {"k": 0}),
        ("cloud", "be at least 4", {"cloud": 3}),
        ("seed", "be at least 0", {"seed": -1}),
        ("descriptors", "be named once each", {"descriptors": ("hks", "dna", "hks")}),
        ("operators", "be named once each", {"operators": ("gradient", "gradient")}),
        ("descriptors", "be among hks, wks, gps, dna, got heat", {"descriptors": ("hks", "heat")}),
        ("operators", "be among stiffness, gradient, got mass", {"operators": ("mass",)}),
    ],
)
def test_plans_that_cannot_be(argument, expected, options):
    refused(argument, expected, Plan, **options)


def test_a_solver_that_does_not_tell_what_it_is():
    for solver in (sk.RayleighRitz(subspace=lambda points, mass: points), Silent()):
        refused("solver", "tell all that decides its results", Plan, solver=solver)


class Silent:
    """A solver without a repr."""

    promise = "exact"

    def eigenpairs(self, laplacian, k):
        return sk.Arpack().eigenpairs(laplacian, k)


def test_seeds_of_nothing_make_no_other_plan():
    assert Plan(seed=1).facts == Plan().facts
    assert Plan(seed=1, cloud=50).facts != Plan(cloud=50).facts


def test_a_file_whose_arrays_lie_beside_it_is_read_again_if_these_change(store, tmp_path):
    mesh = creature(520)
    arrays = mesh.points.astype("<f4").tobytes() + mesh.faces.astype("<u4").tobytes()
    (tmp_path / "a.bin").write_bytes(arrays)
    size = 12 * mesh.n
    views = [{"buffer": 0, "byteLength": size},
             {"buffer": 0, "byteOffset": size, "byteLength": len(arrays) - size}]  # fmt: skip
    accessors = [{"bufferView": 0, "componentType": 5126, "count": mesh.n, "type": "VEC3"},
                 {"bufferView": 1, "componentType": 5125, "count": 3 * len(mesh.faces),
                  "type": "SCALAR"}]  # fmt: skip
    tree = {
        "asset": {"version": "2.0"}, "buffers": [{"uri": "a.bin", "byteLength": len(arrays)}],
        "bufferViews": views, "accessors": accessors, "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}], "scene": 0,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
    }  # fmt: skip
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    first = complete(store, "a", tmp_path / "a.gltf", PLAN)
    assert not complete(store, "a", tmp_path / "a.gltf", PLAN).computed
    doubled = (2 * mesh.points).astype("<f4").tobytes() + arrays[size:]
    (tmp_path / "a.bin").write_bytes(doubled)
    second = complete(store, "a", tmp_path / "a.gltf", PLAN)
    assert second.computed
    assert second.record.area == pytest.approx(4 * first.record.area)


def test_threads_tell_their_own_damage(store, tmp_path):
    files = [tmp_path / f"{i}.off" for i in range(4)]
    for i, file in enumerate(files):
        write(creature(520, seed=i), file)
        complete(store, file.stem, file, PLAN)
    for entry in store.entries("spectra"):
        entry.path.write_bytes(b"")
    filters = list(warnings.filters)
    with ThreadPoolExecutor(4) as pool:
        done = list(pool.map(lambda file: complete(store, file.stem, file, PLAN), files))
    assert warnings.filters == filters
    for one in done:
        assert one.computed
        assert [one.record.spectrum in text for text in one.replaced] == [True]


def test_plans_that_do_not_fit_their_shape():
    cloud = PointCloud(np.random.default_rng(0).random((50, 3)))
    refused("cloud", "sample meshes", Plan(cloud=20).prepared, cloud)
    refused("operator", "be one for points", Plan(operator="cotan").laplacian, cloud)
    refused("boundary", "be neumann on what has none", Plan(boundary="dirichlet").laplacian, cloud)


def test_dirichlet_is_that_of_the_operator(store):
    sheet = rectangle(n=300).geometry
    values = store.spectrum(sheet, Plan(k=5, boundary="dirichlet")).eigenvalues
    expected = sk.eigensolve(sk.laplacian(sheet).dirichlet(sheet.boundary_vertices), 5)
    np.testing.assert_allclose(values, expected.eigenvalues, rtol=1e-10)
    assert values[0] > 1


def test_a_file_that_changed_is_computed_anew_and_one_renamed_is_known(store, tmp_path):
    write(bumpy(), tmp_path / "a.off")
    first = complete(store, "a", tmp_path / "a.off", PLAN)
    assert (first.computed, first.record.kind, first.record.points) == (True, "mesh", bumpy().n)
    write(bumpy(), tmp_path / "b.ply")  # the same shape, in other bytes
    second = complete(store, "b", tmp_path / "b.ply", PLAN)
    assert not second.computed
    assert second.record.spectrum == first.record.spectrum
    write(creature(600), tmp_path / "a.off")
    changed = complete(store, "a", tmp_path / "a.off", PLAN)
    assert changed.computed
    assert [one.renewed for one in (first, second, changed)] == [False, False, True]
    assert store.record("a", PLAN).spectrum == changed.record.spectrum
    assert [record.name for record in store.records(PLAN)].count("a") == 1
    assert list(store.records(Plan(k=13))) == []


def test_what_a_shape_and_a_solver_were_found_to_be_is_remembered(store, tmp_path):
    open_mesh = TriangleMesh(bumpy().points, bumpy().faces[:-30])
    write(open_mesh, tmp_path / "a.off")
    plan = Plan(
        k=12, solver=sk.RayleighRitz(subspace=sk.eigen.subspaces.RandomBasis(m=30)), repair=True
    )
    write(open_mesh, tmp_path / "copy.ply")
    first = complete(store, "a", tmp_path / "a.off", plan)
    second = complete(store, "a", tmp_path / "a.off", plan)
    assert first.record.warnings
    assert (second.record, second.computed) == (first.record, False)
    copy = complete(store, "copy", tmp_path / "copy.ply", plan)
    assert (copy.record.warnings, copy.computed) == (first.record.warnings, False)
    assert first.record.level == "residuals"
    assert (first.record.components, first.record.zero_modes) == (1, 1)


def test_a_file_that_cannot_be_read_leaves_no_record(store, tmp_path):
    (tmp_path / "a.off").write_text("OFF\n1 1 0\n")
    for file in ("a.off", "none.off"):
        with pytest.raises(InvalidFileError, match=file):
            complete(store, "a", tmp_path / file, PLAN)
    assert list(store.entries()) == []


def test_what_needs_more_memory_than_there_is_is_not_tried(store, tmp_path):
    write(bumpy(), tmp_path / "a.off")
    needed = PLAN.gigabytes(bumpy().n)
    with (
        pytest.raises(OutOfMemoryError, match="raise memory_limit, or lower nworkers"),
        memory_of(0.9 * needed),
    ):
        complete(store, "a", tmp_path / "a.off", PLAN)
    assert list(store.entries("spectra")) == []
    with memory_of(1.1 * needed):
        assert complete(store, "a", tmp_path / "a.off", PLAN).computed
    with memory_of(0.1 * needed):
        assert not complete(store, "a", tmp_path / "a.off", PLAN).computed


# --- several at once ---


@dataclass(frozen=True)
class Together(sk.Dense):
    """Solves exactly, and remembers how many it was given at once."""

    asked: ClassVar[list[int]] = []

    def begin(self, laplacians, k):
        self.asked.append(len(laplacians))
        return [partial(self.eigenpairs, one, k) for one in laplacians]


def test_shapes_are_solved_for_together_and_each_fails_for_itself(store, tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", "2")
    monkeypatch.setattr(Together, "asked", [])
    plan = Plan(k=12, solver=Together(), descriptors=("dna",))
    for i in range(5):
        write(creature(520 - i, seed=i), tmp_path / f"{i}.off")
    (tmp_path / "copy.off").write_bytes((tmp_path / "0.off").read_bytes())
    (tmp_path / "empty.off").touch()
    write(PointCloud(np.random.default_rng(0).random((10, 3))), tmp_path / "few.ply")
    paths = sorted(tmp_path.glob("*.*"))
    alone = SpectrumStore(tmp_path / "alone")
    done = list(begin(store, ((path.name, path) for path in paths), plan))
    found = {path.name: rest for path, rest in zip(paths, done, strict=True)}
    assert sum(Together.asked) == 5
    assert max(Together.asked) > 1
    for name, argument in (("empty.off", "the file is empty"), ("few.ply", "`k` must be at most")):
        with pytest.raises(SpectraKitError, match=argument):
            found.pop(name)()
        with pytest.raises(SpectraKitError, match=argument):
            complete(alone, name, tmp_path / name, plan)
    made = {name: rest() for name, rest in found.items()}
    assert [name for name, one in made.items() if not one.computed] == ["copy.off"]
    for name, one in made.items():
        assert one.record == complete(alone, name, tmp_path / name, plan).record
    assert content(store.path) == content(alone.path)
    again = begin(store, ((name, tmp_path / name) for name in made), plan)
    assert not any(rest().computed for rest in again)


def out_of_reach(folder):
    """Return a file that no system finds: its name is too long."""
    return folder / f"{300 * 'x'}.off"


def test_a_file_out_of_reach_fails_when_it_is_its_turn(store, tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", "2")
    write(creature(520), tmp_path / "a.off")
    files = [("b", out_of_reach(tmp_path)), ("a", tmp_path / "a.off")]
    first, second = begin(store, files, Plan(k=6, solver=Together()))
    assert second().computed
    with pytest.raises(OSError, match="too long"):
        first()


def test_a_defect_shows_where_shapes_go_together(store, tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", "2")
    write(creature(520), tmp_path / "a.off")
    monkeypatch.setattr("spectra_kit.datasets.shapes.read_file", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        list(begin(store, [("a", tmp_path / "a.off")], Plan(k=6, solver=Together())))


def test_what_was_known_and_is_out_of_reach_is_known_no_more(store, tmp_path):
    path = tmp_path / "a.off"
    write(creature(520), path)
    complete(store, "a", path, PLAN)
    assert known(store, "a", path, PLAN) is not None
    path = out_of_reach(tmp_path)
    assert known(store, "a", path, PLAN) is None
    with pytest.raises(OSError, match="too long"):
        complete(store, "a", path, PLAN)


def test_one_by_one_where_together_is_no_sooner(store, tmp_path, monkeypatch):
    monkeypatch.setattr(Together, "asked", [])
    files = [(f"{i}", tmp_path / f"{i}.off") for i in range(2)]
    for i, (_, path) in enumerate(files):
        write(creature(520, seed=i), path)
    with single_threaded():
        for rest in begin(store, files, Plan(k=6, solver=Together())):
            assert rest().computed
    assert Together.asked == []


def test_what_is_damaged_is_told_by_those_that_go_together(store, tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", "2")
    plan = Plan(k=6, solver=Together())
    write(creature(520), tmp_path / "a.off")
    kept = complete(store, "a", tmp_path / "a.off", plan).record
    path = store._place("shapes", kept.shape)
    path.write_bytes(path.read_bytes()[:-100])
    (rest,) = begin(store, [("a", tmp_path / "a.off")], plan)
    done = rest()
    assert not done.computed
    assert [str(path) in text for text in done.replaced] == [True]
    assert store.shape(kept.shape).n == 520


def test_several_components_are_told_in_the_table(tmp_path):
    """Two balls have two zero modes; ShapeDNA begins behind them, at the 2 of a unit ball."""
    ball = sk.geometry.sphere(subdivisions=3).geometry
    for name, mesh in (
        ("one", ball),
        ("two", joined(ball, ball.with_points(ball.points + [3, 0, 0]))),
    ):
        sk.write(mesh, tmp_path / f"{name}.off")
    plan = Plan(k=6, descriptors=("dna",))
    inputs = find_inputs([tmp_path])
    report = compute_all(inputs, SpectrumStore(tmp_path / "store"), plan)
    one, two = (done.record for _, done in report.completed)
    assert not one.warnings
    assert two.warnings[0].startswith("2 components: 2 zero modes first")
    assert two.eigenvalues[1] == pytest.approx(0, abs=1e-9)
    assert two.dna[0] == pytest.approx(2 * two.area, rel=0.02)
