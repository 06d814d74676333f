"""Evaluation of matching: data, protocols, measurements, memory, report and app."""

import csv
import importlib.util
import json
import os
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import bumpy

from spectra_kit import Arpack, Neo, Polished, Refined, TriangleMesh, eigensolve
from spectra_kit.correspondence import geodesic_errors, way_back
from spectra_kit.errors import InvalidInputError, MissingDependencyError, SpectraKitError
from spectra_kit.evaluation.matching import (
    METHODS,
    THRESHOLDS,
    Outcome,
    PairTable,
    Protocol,
    Settings,
    Side,
    Subject,
    Task,
    demo_subjects,
    make_protocol,
    make_tasks,
    measure_pair,
    methods,
    run_tasks,
    subjects_in,
    summarize_runs,
    truth_between,
    write_matching_report,
)
from spectra_kit.evaluation.matching.oracle import best_candidate
from spectra_kit.evaluation.matching.runner import Run
from spectra_kit.evaluation.matching.spectra import make_solver, operator_of
from spectra_kit.evaluation.matching.summaries import ranked
from spectra_kit.functional_maps import functional_map_from_point_map
from spectra_kit.geometry import creature, permuted

APP = Path(__file__).parents[2] / "apps" / "match_faust.py"
K = 40


@pytest.fixture(scope="module")
def subjects():
    return demo_subjects(700, poses=3)


@pytest.fixture
def settings(subjects, tmp_path):
    return Settings(subjects=subjects, folder=tmp_path / "out", k=K)


PAIR = [("creature0", "creature1")]
PLAIN = ["wks-zoomout"]


# --- subjects ---


def write_subject(path, mesh, **arrays):
    np.savez(path, V=mesh.points.astype(np.float32), F=mesh.faces.astype(np.int32), **arrays)


def test_a_folder_of_subjects(tmp_path):
    mesh = bumpy()
    write_subject(tmp_path / "cat10.npz", mesh, corres=[3, 1], corres_sym=[1, 3])
    write_subject(tmp_path / "cat2.npz", mesh, corres=[5, 6])
    write_subject(tmp_path / "other.npz", mesh)  # no landmarks: no subject
    (tmp_path / "notes.txt").write_text("no mesh")
    found = subjects_in(tmp_path)
    assert list(found) == ["cat10", "cat2"]
    assert {subject.kind for subject in found.values()} == {"cat"}
    truth = truth_between(found["cat10"], found["cat2"])
    np.testing.assert_array_equal(truth.source, [3, 1])
    np.testing.assert_array_equal(truth.target, [5, 6])
    np.testing.assert_array_equal(truth.symmetric, [1, 3])
    assert truth_between(found["cat2"], found["cat10"]).symmetric is None


def test_a_subject_is_what_it_holds():
    mesh = bumpy()
    subject = Subject("a", mesh, np.arange(5))
    assert subject.digest == Subject("b", TriangleMesh(mesh.points, mesh.faces), range(5)).digest
    assert subject.digest != Subject("a", mesh, np.arange(1, 6)).digest
    assert subject.digest != Subject("a", mesh, np.arange(5), np.arange(5)).digest


def test_subjects_refuse(tmp_path):
    mesh = bumpy()
    with pytest.raises(InvalidInputError, match=r"`folder` must hold .npz files with V, F, corres"):
        subjects_in(tmp_path)
    (tmp_path / "cat0.npz").write_bytes(b"PK nothing")
    with pytest.raises(InvalidInputError, match=r"cat0.npz is not a whole subject"):
        subjects_in(tmp_path)
    with pytest.raises(InvalidInputError, match=r"`landmarks of a` must be in \[0, 642\)"):
        Subject("a", mesh, [642])
    with pytest.raises(InvalidInputError, match=r"`mirrored` of a must have shape \(2,\), got"):
        Subject("a", mesh, [0, 1], [0])
    with pytest.raises(InvalidInputError, match=r"share their landmarks, got 2 of a and 1 of b"):
        truth_between(Subject("a", mesh, [0, 1]), Subject("b", mesh, [0]))
    with pytest.raises(InvalidInputError, match="`poses` must be at least 2"):
        demo_subjects(poses=1)


# --- protocols ---


@pytest.fixture(scope="module")
def zoo():
    mesh = bumpy()
    names = ["cat0", "cat1", "cat10", "dog1", "dog2", "horse0"]
    return [Subject(name, mesh, [0]) for name in names]


def test_random_pairs_are_ordered_distinct_and_extend_each_other(zoo):
    few, many = (make_protocol("random", zoo, count=n, seed=3).pairs for n in (5, 12))
    assert many[:5] == few
    assert len(set(many)) == 12
    assert all(a != b for a, b in many)
    assert few != make_protocol("random", zoo, count=5, seed=4).pairs
    everything = make_protocol("random", zoo).pairs  # 100 wanted, 30 there
    assert len(everything) == 30
    assert set(everything) == set(make_protocol("all-pairs", zoo).pairs)


def test_pairs_within_a_class(zoo):
    protocol = make_protocol("same-class", zoo)
    assert protocol.symmetric
    assert len(protocol.pairs) == 3 * 2 + 2
    assert all(a.rstrip("0123456789") == b.rstrip("0123456789") for a, b in protocol.pairs)


def test_listed_pairs(zoo, tmp_path):
    path = tmp_path / "pairs.txt"
    path.write_text("cat0\tdog1\n\ndog1 cat0\ncat0 lion7\n")
    protocol = make_protocol("ren-300", zoo, listed=path)
    assert protocol.pairs == (("cat0", "dog1"), ("dog1", "cat0"))
    assert protocol.symmetric
    path.write_text("cat0 dog1 7\n")
    with pytest.raises(InvalidInputError, match=r"line 1 of .* must hold two names"):
        make_protocol("ren-300", zoo, listed=path)


def test_protocols_refuse(zoo, tmp_path):
    with pytest.raises(InvalidInputError, match="`name` must be one of random"):
        make_protocol("some", zoo)
    with pytest.raises(InvalidInputError, match=r"protocol 'all-pairs' must have a pair, found no"):
        make_protocol("all-pairs", zoo[:1])
    for path in (None, tmp_path / "missing"):
        with pytest.raises(InvalidInputError, match="`listed` must be a file with two names"):
            make_protocol("ren-300", zoo, listed=path)
    with pytest.raises(InvalidInputError, match="`count` must be at least 1"):
        make_protocol("random", zoo, count=0)


# --- measurements ---


@pytest.fixture(scope="module")
def copies():
    """An animal, its copy in another order, their spectra, and the true map."""
    mesh = creature(700)
    copy, order = permuted(mesh, seed=1)
    a = Subject("a0", mesh, np.arange(mesh.n), np.roll(np.arange(mesh.n), 7))
    b = Subject("a1", copy, np.argsort(order))
    return a, b, tuple(eigensolve(operator_of(s, "mesh"), K) for s in (a, b)), np.asarray(order)


def measured(source, target, spectra, outcome):
    return measure_pair(source, target, outcome, way_back(*spectra, outcome.point_map))


def test_the_truth_has_no_error(copies):
    a, b, spectra, order = copies
    result = measured(a, b, spectra, Outcome(order, 2.0, 1.0, margin=0.25, ambiguous=True))
    assert result.direct == result.either == result.bijectivity == 0
    assert result.symmetric > 1
    assert not result.flipped
    assert result.auc == result.coverage == 1
    assert result.energy == pytest.approx(1, rel=0.05)  # the tufted Laplacian is intrinsic
    assert result.orientation == pytest.approx(1, abs=1e-3)  # sharp edges at the ears
    assert (result.accuracy == 1).all()
    assert (result.seconds, result.cpu_seconds, result.margin) == (2, 1, 0.25)
    assert result.ambiguous
    assert np.isnan(result.oracle)


def test_the_best_finalist_is_the_one_that_the_truth_prefers(copies):
    a, b, spectra, order = copies
    maps = [functional_map_from_point_map(*spectra, p, k=30) for p in (0 * order, order)]
    same = np.arange(a.mesh.n)
    best = best_candidate(a, b, spectra, maps, same, same)
    np.testing.assert_array_equal(best, order)
    assert best_candidate(a, b, spectra, maps[::-1], same, same) is None
    back = np.argsort(order)
    wrong = Outcome(0 * order, 0, 0, tuple(maps))
    assert measure_pair(a, b, wrong, back, best=best).oracle == 0
    chosen = measure_pair(a, b, wrong, back)  # the chosen one was the best
    assert chosen.oracle == chosen.direct > 10


def test_a_mirrored_map_counts_as_flipped(copies):
    a, b, spectra, order = copies
    result = measured(a, b, spectra, Outcome(a.mirrored[order], 0, 0))
    assert result.symmetric == result.either == 0
    assert result.flipped
    assert result.auc_either == 1 > result.auc


@pytest.mark.parametrize("name", ["match", "wks-zoomout", "wks-orient-zoomout"])
def test_methods_find_a_permutation(copies, name):
    a, b, spectra, order = copies
    outcome = METHODS[name](*(Side(x.mesh, s) for x, s in zip((a, b), spectra, strict=True)))
    np.testing.assert_array_equal(outcome.point_map, order)
    assert outcome.seconds > 0
    assert bool(outcome.candidates) == (name == "match")


def test_pyfm_must_be_installed(copies):
    a, b, spectra, _ = copies
    if importlib.util.find_spec("pyFM"):
        pytest.skip("pyFM is installed")
    sides = [Side(x.mesh, s) for x, s in zip((a, b), spectra, strict=True)]
    with pytest.raises(MissingDependencyError, match=r"cannot be imported \(No module named"):
        methods.match_pyfm(*sides)
    cloud = replace(sides[0], geometry=a.mesh.as_cloud())
    with pytest.raises(InvalidInputError, match="must be meshes: pyFM knows no clouds"):
        methods.match_pyfm(cloud, sides[1])


def test_pyfm_fails_in_another_way_than_by_being_away(copies, tmp_path):
    a, b, spectra, _ = copies
    sides = [Side(x.mesh, s) for x, s in zip((a, b), spectra, strict=True)]
    broken = tmp_path / "python"
    broken.write_text("#!/bin/sh\necho first >&2\necho 'ValueError: too few modes' >&2\nexit 1\n")
    broken.chmod(0o755)
    with pytest.raises(SpectraKitError, match=r"pyFM failed on this pair .*too few modes") as error:
        methods.match_pyfm(*sides, python=str(broken))
    assert not isinstance(error.value, MissingDependencyError)
    with pytest.raises(MissingDependencyError, match="the Python of pyFM must be a program, got"):
        methods.match_pyfm(*sides, python=str(tmp_path / "nowhere"))


def test_errors_can_be_those_of_exact_geodesics(copies, settings):
    a, b, spectra, order = copies
    few = [replace(x, landmarks=x.landmarks[:40], mirrored=None) for x in (a, b)]
    outcome = Outcome(a.mirrored[order], 0, 0, candidates=(np.eye(30),))
    back = way_back(*spectra, outcome.point_map)
    edges, exact = (
        measure_pair(*few, outcome, back, best=outcome.point_map, geodesics=method)
        for method in ("edges", "exact")
    )
    assert 0.8 * edges.direct < exact.direct < edges.direct
    assert exact.oracle == exact.direct
    assert exact.bijectivity == edges.bijectivity
    task = Task("creature0", "creature1", "mesh", "exact", "wks-zoomout")
    assert replace(settings, geodesics="edges").digest(task) == settings.digest(task)
    assert replace(settings, geodesics="exact").digest(task) != settings.digest(task)


def test_windings_of_the_files_do_not_count(copies):
    a, b, spectra, order = copies
    outcome = Outcome(order, 0, 0)
    plain = measured(a, b, spectra, outcome)
    inside_out = replace(b, mesh=TriangleMesh(b.mesh.points, b.mesh.faces[:, ::-1]))
    assert measured(a, inside_out, spectra, outcome).orientation == plain.orientation
    mixed = b.mesh.faces.copy()
    mixed[:9] = mixed[:9, ::-1]
    torn = replace(b, mesh=TriangleMesh(b.mesh.points, mixed))
    assert np.isnan(measured(a, torn, spectra, outcome).orientation)


def test_backends_are_solvers_and_share_no_spectrum(settings):
    kinds = [type(make_solver(name)) for name in ("exact", "neo", "neo-polished", "neo-refined")]
    assert kinds == [Arpack, Neo, Polished, Refined]
    paths = {
        settings.spectrum_path(name, kind, backend)
        for name in ("creature0", "creature1")
        for kind in ("mesh", "cloud")
        for backend in ("exact", "neo", "neo-polished", "neo-refined")
    }
    assert len(paths) == 16
    more = replace(settings, k=K + 1).spectrum_path("creature0", "mesh", "exact")
    assert more not in paths


def test_vertices_at_one_place_are_one_point_of_a_cloud(tmp_path):
    mesh = creature(700)
    # A vertex of no extent is split off, as careless remeshing does: two at one place.
    doubled = TriangleMesh(
        np.vstack([mesh.points, mesh.points[5]]),
        np.vstack([mesh.faces, [[5, mesh.n, int(mesh.faces[mesh.faces[:, 0] == 5][0, 1])]]]),
    )
    copy, order = permuted(doubled, seed=0)
    a, b = Subject("a0", doubled, np.arange(701)), Subject("a1", copy, np.argsort(order))
    settings = Settings(subjects={"a0": a, "a1": b}, folder=tmp_path / "out", k=K)
    tasks = make_tasks([("a0", "a1")], kinds=["cloud"], methods=PLAIN)
    [result] = run_tasks(tasks, settings).results.values()
    assert result.direct == pytest.approx(0, abs=1e-9)
    assert np.load(settings.map_path(tasks[0])).shape == (701,)


# --- running and remembering ---


def test_a_run_is_remembered(settings, monkeypatch):
    tasks = make_tasks(PAIR, kinds=["mesh", "cloud"], backends=["exact", "neo"], methods=PLAIN)
    first = run_tasks(tasks, settings)
    assert list(first.results) == tasks
    assert not first.failures
    assert len(list((settings.folder / "spectra").iterdir())) == 8
    for task in tasks:
        point_map = np.load(settings.map_path(task))
        assert point_map.shape == (settings.subjects[task.target].mesh.n,)

    def never(source, target):
        raise AssertionError("matched again")

    monkeypatch.setitem(METHODS, "wks-zoomout", never)
    second = run_tasks(tasks, settings)
    for task in tasks:
        assert second.results[task].direct == pytest.approx(first.results[task].direct, rel=1e-6)
        np.testing.assert_allclose(
            second.results[task].accuracy, first.results[task].accuracy, rtol=1e-4
        )
    with pytest.raises(AssertionError, match="matched again"):  # other inputs, other results
        run_tasks(tasks, replace(settings, k=K + 1))


def test_maps_in_a_folder_are_those_of_their_results(settings):
    [task] = make_tasks(PAIR, methods=PLAIN)
    few, many = settings, replace(settings, k=2 * K)
    maps = {}
    for one in (few, many):
        run_tasks([task], one)
        maps[one.k] = np.load(one.map_path(task))
    assert (maps[few.k] != maps[many.k]).any()
    [again] = run_tasks([task], few).results.values()
    point_map = np.load(few.map_path(task))
    np.testing.assert_array_equal(point_map, maps[few.k])
    truth = truth_between(*(settings.subjects[name] for name in PAIR[0]))
    mesh = settings.subjects[task.source].mesh
    errors = geodesic_errors(mesh, point_map, truth)
    assert errors.mean() == pytest.approx(again.direct, rel=1e-5)
    few.map_path(task).unlink()  # a result without its map is no result
    run_tasks([task], few)
    np.testing.assert_array_equal(np.load(few.map_path(task)), point_map)


def test_another_python_may_have_another_pyfm(settings):
    [task] = make_tasks(PAIR, methods=["pyfm"])
    assert replace(settings, pyfm_python="/other").digest(task) != settings.digest(task)


@pytest.mark.parametrize("before", [None, "7"])
def test_one_job_has_one_thread(settings, monkeypatch, before):
    from threadpoolctl import threadpool_info

    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    if before:
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", before)
    seen = []

    def watching(source, target):
        seen.append(os.environ["OPENBLAS_NUM_THREADS"])
        seen.extend(i["num_threads"] for i in threadpool_info() if i["user_api"] == "blas")
        return Outcome(np.zeros(target.geometry.n, np.int64), 0, 0)

    monkeypatch.setitem(METHODS, "wks-zoomout", watching)
    run_tasks(make_tasks(PAIR, methods=PLAIN), settings)
    assert {str(count) for count in seen} == {"1"}
    assert os.environ.get("OPENBLAS_NUM_THREADS") == before


def test_an_interruption_loses_one_pair(settings, monkeypatch):
    tasks = make_tasks([*PAIR, ("creature1", "creature2")], methods=PLAIN)
    calls = []

    def interrupted(source, target):
        calls.append(0)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return Outcome(np.zeros(target.geometry.n, np.int64), 0, 0)

    monkeypatch.setitem(METHODS, "wks-zoomout", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run_tasks(tasks, settings)
    assert len((settings.folder / "pairs.csv").read_text().splitlines()) == 2
    assert not list(settings.folder.rglob(".*"))
    assert len(run_tasks(tasks, settings).results) == 2
    assert len(calls) == 3


def test_failures_say_why_and_are_not_remembered(settings):
    few = replace(settings, k=10)  # the fit needs 30
    run = run_tasks(make_tasks(PAIR, methods=PLAIN), few)
    assert not run.results
    [why] = run.failures.values()
    assert "k" in why
    assert len((few.folder / "pairs.csv").read_text().splitlines()) == 1
    many = replace(settings, k=5000)  # more than vertices
    [why] = run_tasks(make_tasks(PAIR, methods=PLAIN), many).failures.values()
    assert why.startswith("creature0: `k` must be")
    text = write_matching_report(run, few, Protocol("random", tuple(PAIR))).read_text()
    assert "Nothing was measured" in text
    assert "Not matched" in text


def test_a_line_cut_short_is_dropped_and_another_file_refused(tmp_path, copies):
    a, b, spectra, order = copies
    path = tmp_path / "pairs.csv"
    task = Task("a0", "a1", "mesh", "exact", "wks-zoomout")
    result = measured(a, b, spectra, Outcome(order, 1.5, 1.25))
    table = PairTable(path)
    table.add(task, "x", result)
    table.add(task, "y", result)
    text = path.read_text()
    path.write_text(text[:-30])
    again = PairTable(path)
    assert again.get(task, "y") is None
    assert again.get(task, "x").seconds == 1.5
    assert np.isnan(again.get(task, "x").oracle)
    again.add(task, "y", result)
    assert path.read_text() == text

    path.write_text(text.replace("1.5,", "soon,", 1))
    with pytest.raises(InvalidInputError, match=r"line 2 of .* must be a matched pair"):
        PairTable(path)
    path.write_text("a,b\n1,2\n")
    with pytest.raises(InvalidInputError, match="must be a table of matched pairs"):
        PairTable(path)


def test_tasks():
    tasks = make_tasks(PAIR, kinds=["mesh", "cloud"], methods=["wks-zoomout", "pyfm"])
    assert [(t.kind, t.method) for t in tasks] == [
        ("mesh", "wks-zoomout"),
        ("cloud", "wks-zoomout"),
        ("mesh", "pyfm"),
    ]
    with pytest.raises(InvalidInputError, match=r"`backends` must be among exact, .*got magic"):
        make_tasks(PAIR, backends=["magic"])


@pytest.mark.slow
def test_processes_find_the_same_and_a_killed_run_goes_on(tmp_path):
    out = tmp_path / "out"
    command = [sys.executable, str(APP), str(out), "--demo", "-k", str(K), "--pairs", "6"]
    command += ["--no-pictures", "--methods", *PLAIN]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(
        [*command, "--jobs", "2"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=environment,
        start_new_session=True,
    )
    table = out / "pairs.csv"
    wait_for(lambda: table.exists() and len(table.read_text().splitlines()) > 2, process)
    process.kill()  # no handler runs
    process.wait()
    before = table.read_text().splitlines()
    wait_for(lambda: not group_lives(process.pid))  # its workers follow

    done = subprocess.run(
        [*command, "--jobs", "1"], capture_output=True, text=True, env=environment, check=True
    )
    assert done.stderr == ""  # no bar in a pipe
    after = table.read_text().splitlines()
    assert len(after) == 7
    assert after[: len(before) - 1] == before[:-1]
    # Nothing tidies up after a kill: a part of a file may lie there, but never under its real name.
    maps = sorted(path for path in out.rglob("maps/*/*.npy") if not path.name.startswith("."))
    assert len(maps) == 6
    subjects = demo_subjects()
    for path in maps:
        target = path.stem.split("--")[1]
        assert np.load(path).shape == (subjects[target].mesh.n,)

    task = next(iter(csv.DictReader(after)))
    alone = Settings(subjects=subjects, folder=tmp_path / "alone", k=K)
    run = run_tasks(make_tasks([(task["source"], task["target"])], methods=PLAIN), alone)
    [result] = run.results.values()
    assert result.direct == pytest.approx(float(task["direct"]), rel=1e-6)


def wait_for(condition, process=None, seconds=300):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        assert process is None or process.poll() is None
        time.sleep(0.05)


def group_lives(group):
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    if not Path("/proc/self/stat").exists():
        return True
    # An ended process that nobody waited for counts as ended: not every init waits for orphans.
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(FileNotFoundError, ProcessLookupError):
            state, _, its_group = path.read_text().rsplit(")", 1)[1].split()[:3]
            if state != "Z" and int(its_group) == group:
                return True
    return False


# --- sums and report ---


def results_with(direct, either=None, **fields):
    """Made-up results of as many pairs."""
    either = direct if either is None else either
    values = dict.fromkeys(
        ["symmetric", "auc", "auc_either", "coverage", "energy", "bijectivity", "orientation"], 0.5
    )
    values |= {"oracle": 1.0, "margin": 0.1, "seconds": 2.0, "cpu_seconds": 1.0, "flipped": False}
    values |= {"ambiguous": False}
    curve = np.ones(len(THRESHOLDS))
    return [
        methods_result(values | fields | {"direct": d, "either": e}, curve)
        for d, e in zip(direct, either, strict=True)
    ]


def methods_result(values, curve):
    from spectra_kit.evaluation.matching import PairResult

    return PairResult(**values, accuracy=curve, accuracy_either=curve)


def made_up_run():
    run = Run()
    for backend, direct, either in (
        ("exact", [1.0, 2.0, 9.0], [1.0, 1.5, 2.0]),
        ("neo", [2.0, 4.0, 18.0], [2.0, 3.0, 4.0]),
    ):
        for i, result in enumerate(results_with(direct, either)):
            run.results[Task(f"s{i}", "t", "mesh", backend, "wks-zoomout")] = result
    return run


def test_summaries_do_their_sums():
    run, protocol = made_up_run(), Protocol("random", (("s0", "t"),))
    exact, neo = summarize_runs(run.results, protocol)
    assert (exact.mean, exact.median, exact.bad) == (4, 2, pytest.approx(1 / 3))
    assert (exact.pairs, exact.direct, exact.either) == (3, 4, 1.5)
    assert (exact.flipped, exact.partly) == (0, 1)
    assert neo.mean == 8
    assert [t.source for t in ranked(run, neo.name, protocol)] == ["s0", "s1", "s2"]
    counted = summarize_runs(run.results, replace(protocol, symmetric=True))
    assert (counted[0].mean, counted[0].bad) == (1.5, 0)
    assert exact.label == "wks-zoomout, exact"
    for task, result in run.results.items():
        run.results[task] = replace(result, ambiguous=task.source != "s1")
    warned = summarize_runs(run.results, protocol)[0]
    assert (warned.warned, warned.false_alarms) == (1, 1)


def test_without_a_symmetric_truth_nothing_is_called_flipped(settings):
    settings.folder.mkdir()
    run, protocol = made_up_run(), Protocol("random", (("s0", "t"),))
    first = next(iter(run.results))
    run.results[first] = replace(run.results[first], symmetric=float("nan"))
    unknown, known = summarize_runs(run.results, protocol)
    assert (unknown.flipped, unknown.partly) == (None, None)
    assert (known.flipped, known.partly) == (0, 1)
    text = write_matching_report(run, settings, protocol).read_text()
    assert "| 4.00 |  | 1.50 |  |  | 1.00 |" in text  # direct to best finalist
    record = json.loads((settings.folder / "matching.json").read_text())
    assert record["summaries"][0]["symmetric"] is None
    assert record["summaries"][0]["flipped"] is None


def test_report_names_protocol_numbers_and_ratio(settings):
    settings.folder.mkdir()
    run, protocol = made_up_run(), Protocol("random", (("s0", "t"),))
    text = write_matching_report(run, settings, protocol).read_text()
    assert "ordered pairs drawn at random" in text
    assert "| wks-zoomout, exact | 3 | **4.00** | 2.00 | 33% |" in text
    assert "wks-zoomout, neo: 2.00 times the mean error with exact spectra" in text
    for words in ("along the edges of the source", "left for right", "A pair has one thread"):
        assert words in text
    assert "by its inputs (meshes, landmarks, modes, weights) and the release" in text
    assert "pyFM" not in text
    record = json.loads((settings.folder / "matching.json").read_text())
    assert record["summaries"][1]["mean"] == 8
    assert record["geodesics"] == "edges"
    assert (settings.folder / "accuracy.png").stat().st_size > 10_000
    for task, result in list(run.results.items()):
        run.results[replace(task, backend="exact", method="pyfm")] = result
    exact = replace(settings, geodesics="exact")
    text = write_matching_report(run, exact, protocol).read_text()
    assert "exact geodesic distances on the source" in text
    assert "pyfm: pyFM with the parameters of its README (version 1.3.1): 30 modes" in text


# --- the app ---


@pytest.fixture(scope="module")
def app():
    specification = importlib.util.spec_from_file_location("match_faust", APP)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module.main


@pytest.mark.slow
def test_the_app_measures_draws_and_prints(app, tmp_path, capsys):
    arguments = [str(tmp_path / "out"), "--demo", "--pairs", "2", "-k", str(K), "--jobs", "1"]
    assert app([*arguments, "--methods", "wks-zoomout"]) == 0
    out, err = capsys.readouterr()
    assert "12 pairs" not in out
    assert "2 pairs (all-pairs" in out
    if "OpenGL" not in err:
        picture = tmp_path / "out" / "extremes-mesh-exact-wks-zoomout.png"
        assert f"picture: {picture}" in out
        assert picture.stat().st_size > 50_000


def test_the_app_says_what_is_wrong(app, tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("SPECTRA_KIT_DATA", raising=False)
    out = str(tmp_path / "out")
    assert app([out]) == 2
    assert "name a folder with --data" in capsys.readouterr().err
    assert app([out, "--data", str(tmp_path)]) == 2
    assert "must hold .npz files" in capsys.readouterr().err
    few = ["--demo", "--pairs", "1", "-k", "9999", "--jobs", "1", "--no-pictures"]
    assert app([out, *few, "--geodesics", "exact"]) == 1
    report = capsys.readouterr().out
    assert "Not matched" in report
    assert "exact geodesic distances on the source" in report


def test_the_app_can_be_interrupted(app, tmp_path, capsys, monkeypatch):
    def interrupted(*sides):
        raise KeyboardInterrupt

    monkeypatch.setitem(METHODS, "wks-zoomout", interrupted)
    arguments = ["--demo", "--pairs", "1", "-k", str(K), "--jobs", "1", "--methods", "wks-zoomout"]
    assert app([str(tmp_path / "out"), *arguments]) == 130
    assert "run the same command to continue" in capsys.readouterr().err


@pytest.mark.data
def test_pairs_of_the_real_set():
    root = os.environ.get("SPECTRA_KIT_DATA")
    if not root or not (Path(root) / "faust_r").is_dir():
        pytest.skip("set SPECTRA_KIT_DATA to the folder of real shapes to run this")
    folder = Path(root) / "faust_r"
    subjects = subjects_in(folder)
    assert len(make_protocol("all-pairs", subjects.values()).pairs) == 80 * 79
    listed = make_protocol("ren-300", subjects.values(), listed=folder / "ren_pairs.txt")
    assert len(listed.pairs) == 206
