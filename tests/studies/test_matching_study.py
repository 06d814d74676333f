"""The study of matching: data, protocols, measurements, memory and commands."""

import csv
import json
import pickle
from dataclasses import replace

import numpy as np
import pytest
from conftest import bumpy, creature
from studies import run as command
from studies.matching import collection, dense, methods, sets
from studies.matching.command import summarize
from studies.matching.measures import THRESHOLDS, best_candidate, measure_map
from studies.matching.methods import METHODS, Entry, Outcome, Side
from studies.matching.pairs import BACKENDS, KINDS, Pair, Pairs, Spectra, match_all, ways
from studies.matching.sets import Protocol, make_protocol
from studies.matching.subjects import Subject, demo_subjects, subjects_in, truth_between

from spectra_kit import TriangleMesh, eigensolve, robust_laplacian
from spectra_kit.errors import InvalidInputError, SpectraKitError
from spectra_kit.geometry import permuted
from spectra_kit.maps import functional_map_from_point_map, geodesic_errors, inverse_map

K = 40
PAIR, PLAIN = Pair("creature0", "creature1"), "wks-zoomout"


@pytest.fixture(scope="module")
def subjects():
    return demo_subjects(500, poses=3)


@pytest.fixture
def study(subjects, tmp_path):
    """Return a function that makes the study of some pairs, by the plain method on meshes."""

    def pairs_of(*pairs, k=K, subjects=subjects, chosen=None, **options):
        chosen = ways(methods=[PLAIN]) if chosen is None else chosen
        bases = list(dict.fromkeys(way.basis for way in chosen))
        spectra = Spectra(
            folder=tmp_path, contenders=bases, problems=list(subjects), subjects=subjects, k=k
        )
        return Pairs(
            folder=tmp_path,
            contenders=chosen,
            problems=pairs or (PAIR,),
            spectra=spectra,
            **options,
        )

    return pairs_of


# --- subjects and protocols ---


def write_subject(path, mesh, **arrays):
    np.savez(path, V=mesh.points.astype(np.float32), F=mesh.faces.astype(np.int32), **arrays)


def test_a_folder_of_subjects(tmp_path):
    mesh = bumpy()
    write_subject(tmp_path / "cat10.npz", mesh, corres=[3, 1], corres_sym=[1, 3])
    write_subject(tmp_path / "cat2.npz", mesh, corres=[5, 6])
    write_subject(tmp_path / "mesh052.npz", mesh, corres=[3, 1], corres_sym=[3, 1])
    write_subject(tmp_path / "other.npz", mesh)  # no landmarks: no subject
    (tmp_path / "notes.txt").write_text("no mesh")
    found = subjects_in(tmp_path)
    assert list(found) == ["cat10", "cat2", "mesh052"]
    assert found["cat10"].species == found["cat2"].species == "cat"
    assert found["mesh052"].mirrored is None  # mirror images that are the landmarks are none
    truth = truth_between(found["cat10"], found["cat2"])
    np.testing.assert_array_equal(truth.source, [3, 1])
    np.testing.assert_array_equal(truth.target, [5, 6])
    np.testing.assert_array_equal(truth.symmetric, [1, 3])
    assert truth_between(found["cat2"], found["cat10"]).symmetric is None


@pytest.fixture(scope="module")
def zoo():
    names = ["cat0", "cat1", "cat10", "dog1", "dog2", "horse0"]
    return [Subject(name, bumpy(), [0]) for name in names]


def test_random_pairs_are_ordered_distinct_and_extend_each_other(zoo):
    few, many = (make_protocol("random", zoo, count=n, seed=3).pairs for n in (5, 12))
    assert many[:5] == few
    assert len(set(many)) == 12
    assert all(a != b for a, b in many)
    assert few != make_protocol("random", zoo, count=5, seed=4).pairs
    everything = make_protocol("random", zoo).pairs  # 100 wanted, 30 there
    assert len(everything) == 30
    assert set(everything) == set(make_protocol("all-pairs", zoo).pairs)


def test_pairs_within_a_class_and_listed_ones(zoo, tmp_path):
    protocol = make_protocol("same-class", zoo)
    assert len(protocol.pairs) == 3 * 2 + 2
    assert all(a.rstrip("0123456789") == b.rstrip("0123456789") for a, b in protocol.pairs)
    path = tmp_path / "pairs.txt"
    path.write_text("cat0\tdog1\n\ndog1 cat0\ncat0 lion7\n")
    listed = make_protocol("ren-300", zoo, listed=path)
    assert listed.pairs == (("cat0", "dog1"), ("dog1", "cat0"))
    assert listed.symmetric  # they count the smaller error
    assert not protocol.symmetric
    assert not make_protocol("all-pairs", zoo).symmetric


def test_damaged_and_foreign_subjects(zoo, tmp_path):
    (tmp_path / "cat0.npz").write_bytes(b"PK nothing")
    (tmp_path / "list").write_text("cat0 dog1 7\n")
    a, b = (Subject(name, bumpy(), corners) for name, corners in (("a", [0, 1]), ("b", [0])))
    for call, match in (
        (lambda: subjects_in(tmp_path), r"cat0.npz: not a whole subject"),
        (lambda: Subject("a", bumpy(), [642]), r"`landmarks of a` must be in \[0, 642\)"),
        (lambda: truth_between(a, b), r"share their landmarks, got 2 of a and 1 of b"),
        (lambda: make_protocol("all-pairs", zoo[:1]), r"'all-pairs' must have a pair, found no"),
        (lambda: make_protocol("ren-300", zoo, listed=tmp_path / "list"), r"line 1 .* two names"),
    ):
        with pytest.raises(InvalidInputError, match=match):
            call()


# --- measurements ---


@pytest.fixture(scope="module")
def copies():
    """An animal, its copy in another order and unit, their spectra, and the true map."""
    mesh = creature(700)
    copy, order = permuted(mesh, seed=1)
    copy = copy.with_points(1000 * copy.points)
    a = Subject("a0", mesh, np.arange(mesh.n), np.roll(np.arange(mesh.n), 7))
    b = Subject("a1", copy, np.argsort(order))
    spectra = tuple(eigensolve(robust_laplacian(s.mesh), K) for s in (a, b))
    return a, b, spectra, np.asarray(order)


def measured(source, target, spectra, outcome):
    return measure_map(source, target, outcome, inverse_map(*spectra, outcome.point_map))


def test_the_truth_has_no_error(copies):
    a, b, spectra, order = copies
    result = measured(a, b, spectra, Outcome(order, 2.0, 1.0, margin=0.25, ambiguous=True))
    assert result["direct"] == result["either"] == result["bijectivity"] == 0
    assert result["symmetric"] > 1
    assert result["auc"] == result["coverage"] == 1
    assert result["energy"] == pytest.approx(1, rel=0.05)  # the tufted Laplacian is intrinsic
    assert result["orientation"] == pytest.approx(1, abs=1e-3)  # sharp edges at the ears
    assert result["accuracy"] == [1] * len(THRESHOLDS)
    assert (result["seconds"], result["cpu_seconds"], result["margin"]) == (2, 1, 0.25)
    assert (result["flipped"], result["ambiguous"]) == (False, True)
    assert np.isnan(result["oracle"])
    result = measured(a, b, spectra, Outcome(a.mirrored[order], 0, 0))
    assert result["symmetric"] == result["either"] == 0
    assert result["flipped"]
    assert result["auc_either"] == 1 > result["auc"]


def test_the_best_finalist_is_the_one_that_the_truth_prefers(copies):
    a, b, spectra, order = copies
    maps = [functional_map_from_point_map(*spectra, p, k=30) for p in (0 * order, order)]
    same = np.arange(a.mesh.n)
    best = best_candidate(a, b, spectra, maps, same, same)
    np.testing.assert_array_equal(best, order)
    assert best_candidate(a, b, spectra, maps[::-1], same, same) is None
    back = np.argsort(order)
    wrong = Outcome(0 * order, 0, 0, tuple(maps))
    assert measure_map(a, b, wrong, back, best=best)["oracle"] == 0
    chosen = measure_map(a, b, wrong, back)  # the chosen one was the best
    assert chosen["oracle"] == chosen["direct"] > 10
    few = [replace(x, landmarks=x.landmarks[:40], mirrored=None) for x in (a, b)]
    edges, exact = (measure_map(*few, wrong, back, geodesics=how) for how in ("edges", "exact"))
    assert 0.8 * edges["direct"] < exact["direct"] < edges["direct"]
    assert exact["oracle"] == exact["direct"]


# --- methods ---


@pytest.mark.parametrize("name", ["match", "wks-zoomout", "wks-orient-zoomout"])
def test_methods_find_a_permutation(copies, name):
    a, b, spectra, order = copies
    outcome = METHODS[name].run(*(Side(x.mesh, s) for x, s in zip((a, b), spectra, strict=True)))
    np.testing.assert_array_equal(outcome.point_map, order)
    assert outcome.seconds > 0
    assert bool(outcome.candidates) == (name == "match")


def test_pyfm_may_be_away_or_fail(copies, tmp_path):
    a, b, spectra, _ = copies
    sides = [Side(x.mesh, s) for x, s in zip((a, b), spectra, strict=True)]
    program = tmp_path / "python"
    with pytest.raises(SpectraKitError, match=r"pyFM failed on this pair .*No such file"):
        methods.match_pyfm(*sides, python=str(program))
    program.touch(0o755)
    program.write_text("#!/bin/sh\necho first >&2\necho 'No module' >&2\nexit 1\n")
    with pytest.raises(SpectraKitError, match=r"pyFM failed .*\(No module\).* pip install"):
        methods.match_pyfm(*sides, python=str(program))


# --- running and remembering ---


def test_a_run_is_remembered_with_its_maps(study, monkeypatch):
    pairs = study(chosen=ways(["mesh"], ["exact", "neo"], [PLAIN]))
    first = match_all(pairs, jobs=0)
    assert [result.contender for result in first] == pairs.contenders
    assert len(list((pairs.folder / "spectra").iterdir())) == 4
    subjects = pairs.spectra.subjects
    for result in first:
        point_map = np.load(pairs.map_path(result.contender, PAIR))
        truth = truth_between(*(subjects[name] for name in ("creature0", "creature1")))
        errors = geodesic_errors(subjects["creature0"].mesh, point_map, truth)
        assert errors.mean() == pytest.approx(result.record["direct"], rel=1e-9)

    plain = METHODS[PLAIN]
    monkeypatch.setitem(METHODS, PLAIN, Entry(None))
    again = match_all(pairs, jobs=0)
    assert [result.record for result in again] == [result.record for result in first]
    monkeypatch.setitem(METHODS, PLAIN, plain)
    path = pairs.map_path(first[0].contender, PAIR)
    before = np.load(path)
    path.unlink()  # a result without its map is no result
    match_all(pickle.loads(pickle.dumps(pairs)), jobs=0)  # as another process has it
    np.testing.assert_array_equal(np.load(path), before)


def test_vertices_at_one_place_are_one_point_of_a_cloud(study):
    mesh = creature(700)
    # A vertex of no extent is split off, as careless remeshing does: two at one place.
    doubled = TriangleMesh(
        np.vstack([mesh.points[5], mesh.points]),
        np.vstack([mesh.faces + 1, [[6, 0, 1 + int(mesh.faces[mesh.faces[:, 0] == 5][0, 1])]]]),
    )
    copy, order = permuted(doubled, seed=0)
    two = {"a0": Subject("a0", doubled, range(701)), "a1": Subject("a1", copy, np.argsort(order))}
    pairs = study(Pair("a0", "a1"), subjects=two, chosen=ways(["cloud"], methods=[PLAIN]))
    [result] = match_all(pairs, jobs=0)
    assert result.record["direct"] == pytest.approx(0, abs=1e-9)
    assert np.load(pairs.map_path(result.contender, result.problem)).shape == (701,)


def test_everything_that_decides_a_result_is_in_its_key(study, subjects):
    [way], [own] = ways(methods=[PLAIN]), ways(methods=["pyfm"])
    pairs = study()
    keys = [
        study(**options).key(way, PAIR)
        for options in (
            {},
            {"k": K + 1},
            {"geodesics": "exact"},
            {"subjects": {**subjects, "creature0": subjects["creature2"]}},
        )
    ]
    keys += [study(pyfm_python=python).key(own, PAIR) for python in (None, "/other")]
    keys += [pairs.key(other, PAIR) for other in ways(KINDS, BACKENDS, [PLAIN]) if other != way]
    keys.append(pairs.key(way, Pair("creature1", "creature0")))
    assert len(set(keys)) == len(keys)
    assert study(pyfm_python="/other").key(way, PAIR) == keys[0]


# --- sums and tables ---


PROTOCOL = Protocol("random", (("s0", "t"),))
LISTED = Protocol("ren-300", PROTOCOL.pairs)


def records_of(errors):
    """Made-up records, by direct errors and the smaller ones."""
    names = ["symmetric", "auc", "auc_either", "coverage", "energy", "bijectivity", "orientation"]
    made_up = dict.fromkeys([*names, "oracle", "seconds", "cpu_seconds"], 0.5)
    made_up |= {"confidence": float("nan"), "flipped": False, "ambiguous": False}
    return [{**made_up, "direct": direct, "either": either} for direct, either in errors]


def test_summaries_do_their_sums():
    records = records_of([(1.0, 1.0), (2.0, 1.5), (9.0, 2.0)])
    exact = summarize(records, PROTOCOL)
    assert (exact["mean"], exact["median"], exact["over 8"]) == (4, 2, pytest.approx(1 / 3))
    assert exact["worst"] == 9
    assert (exact["pairs"], exact["direct"], exact["either"]) == (3, 4, 1.5)
    assert (exact["flipped"], exact["partly"]) == (0, 1)
    counted = summarize(records, LISTED)
    assert (counted["mean"], counted["over 8"]) == (1.5, 0)
    warned = [{**one, "ambiguous": i != 1} for i, one in enumerate(records)]
    found = summarize(warned, PROTOCOL)
    assert (found["doubted wrong"], found["doubted right"]) == ("1/1", "1/2")
    sure = [{**one, "confidence": c} for one, c in zip(warned, (0.4, 0.5, 0.6), strict=True)]
    found = summarize(sure, PROTOCOL)  # a confidence says more than a yes or no
    assert (found["doubted wrong"], found["doubted right"]) == ("0/1", "1/2")
    one_sided = [*records[:2], {**records[2], "symmetric": float("nan")}]
    unknown = summarize(one_sided, PROTOCOL)  # without a symmetric truth nothing is flipped
    assert (unknown["flipped"], unknown["partly"]) == (None, None)


# --- the commands ---


def test_the_command_matches_draws_and_goes_on(subjects, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sets, "demo_subjects", lambda: dict([*subjects.items()][:2]))
    words = ["matching", str(tmp_path), "--demo", "--pairs", "2", "-k", "30", "--jobs", "0"]
    words += ["--methods", PLAIN]
    assert command.main(words) == 0
    assert capsys.readouterr().err == ""  # no bar in a pipe
    assert (tmp_path / "extremes-demo-mesh-exact-wks-zoomout.png").stat().st_size > 20_000
    lines = list(csv.DictReader((tmp_path / "matching.csv").read_text().splitlines()))
    maps = tmp_path.rglob("maps/*/*.npy")
    assert sorted(path.stem.split("--")[2] for path in maps) == sorted(x["key"] for x in lines)
    journal = (tmp_path / "measurements.jsonl").read_text()
    assert command.main([*words, "--no-pictures"]) == 0
    assert (tmp_path / "measurements.jsonl").read_text() == journal


def test_failures_are_told_and_an_interrupt_goes_on(subjects, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sets, "demo_subjects", lambda: dict([*subjects.items()][:2]))
    words = ["matching", str(tmp_path), "--demo", "--pairs", "1", "--jobs", "0", "--no-pictures"]
    assert command.main([*words, "--methods", PLAIN, "-k", "9999"]) == 1
    said = capsys.readouterr().out
    assert "Not measured" in said
    assert "creature0: `k` must be" in said

    def interrupted(*sides):
        raise KeyboardInterrupt

    monkeypatch.setitem(METHODS, PLAIN, Entry(interrupted))
    assert command.main([*words, "--methods", PLAIN, "-k", "30"]) == 130
    assert "the same command goes on from here" in capsys.readouterr().err


def test_sets_are_matched_as_one_collection_and_with_many_vertices(subjects, tmp_path, monkeypatch):
    for study in (collection, dense):
        monkeypatch.setattr(study, "_MODES", 60)
    for name, subject in [*subjects.items()][:2]:
        write_subject(tmp_path / f"{name}.npz", subject.mesh, corres=subject.landmarks)
    out, data = tmp_path / "out", ["--data", str(tmp_path)]
    assert command.main(["collection", str(out), *data, "--pairs", "1"]) == 0
    [row] = json.loads((out / "collection.json").read_text())["tables"]["Maps between pairs"]
    assert (row["shapes"], row["groups"], row["fits no other"]) == (2, [2], "")
    assert row["worst"] < 5
    assert command.main(["dense", str(out), *data, "--pairs", "1", "--vertices", "1000"]) == 0
    [record] = map(json.loads, (out / "measurements.jsonl").read_text().splitlines())
    assert record["vertices"] >= 1000
    assert max(record["error"], record["coarse"], record["rounded"]) < 5
