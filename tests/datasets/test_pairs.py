"""Maps of many pairs: the true ones, once each, whoever works; failures beside results."""

import csv
import shutil
from dataclasses import replace

import numpy as np
import pytest
from conftest import bumpy, creature, refused, two_parts

import spectra_kit as sk
from spectra_kit.datasets import (
    Input,
    Matching,
    Pair,
    Plan,
    SpectrumStore,
    complete,
    compute_all,
    find_pairs,
    load_match,
    match_all,
    shard,
    write_table,
)
from spectra_kit.datasets.pairs import KEPT, _arrays, _restored, in_tiles, prepared
from spectra_kit.datasets.run import own_order
from spectra_kit.errors import DoubtfulMatchWarning, InvalidFileError, InvalidInputError
from spectra_kit.geometry import TriangleMesh, mirrored, write

PLAN = Plan(k=40)
QUICK = Matching(options=sk.maps.MatchOptions(growing=16, finalists=3, rounds=1))


def shuffled(mesh, seed):
    """The same surface with its vertices in another order, and the new place of each."""
    order = np.random.default_rng(seed).permutation(mesh.n)
    place = np.argsort(order)
    return TriangleMesh(mesh.points[order], place[mesh.faces]), order


@pytest.fixture(scope="module")
def shapes(tmp_path_factory):
    """Files of an animal, its mirror image, a shuffled copy, and one in two parts."""
    folder = tmp_path_factory.mktemp("shapes")
    write(creature(520), folder / "animal.off")
    write(mirrored(creature(520)), folder / "image.off")
    write(shuffled(creature(520), 0)[0], folder / "shuffled.off")
    write(two_parts(), folder / "parts.off")
    return {path.stem: path for path in sorted(folder.glob("*.off"))}


def filled(path, shapes, names=("animal", "image", "shuffled"), plan=PLAN):
    store = SpectrumStore(path)
    inputs = [Input(name=name, path=shapes[name]) for name in names]
    assert not compute_all(inputs, store, plan).failed
    return store


@pytest.fixture(scope="module")
def solved(tmp_path_factory, shapes):
    return filled(tmp_path_factory.mktemp("solved"), shapes)


@pytest.fixture(scope="module")
def run(tmp_path_factory, solved):
    """A store with quick maps of all pairs, and the report of the run that made them."""
    store = copy_of(solved, tmp_path_factory.mktemp("run") / "store")
    return store, match_all(find_pairs("all", store), store, matching=QUICK)


def copy_of(store, path):
    shutil.copytree(store.path, path)
    return SpectrumStore(path)


@pytest.fixture
def store(tmp_path, solved):
    """Spectra without maps, the test's own."""
    return copy_of(solved, tmp_path / "store")


@pytest.fixture
def mapped(tmp_path, run):
    """The same with all maps."""
    return copy_of(run[0], tmp_path / "mapped")


def content(store):
    return {entry.key: entry.path.read_bytes() for entry in store.entries("maps")}


def test_maps_are_the_true_ones_and_those_of_match(store):
    pairs = find_pairs("all", store)
    assert [pair.name for pair in pairs] == [
        *("animal to image", "animal to shuffled", "image to shuffled")
    ]
    told = []
    prepared.cache_clear()
    report = match_all(pairs, store, matching=QUICK, progress=lambda *args: told.append(args))
    assert told == [(1, 3), (2, 3), (3, 3)]
    assert prepared.cache_info().misses == 3  # once each, for two pairs
    assert (report.computed, report.failed, report.replaced) == (3, (), ())
    _, order = shuffled(creature(520), 0)
    truths = [np.arange(520), order, order]
    for (pair, done), truth, turned in zip(
        report.completed, truths, (True, False, True), strict=True
    ):
        found = done.record
        kept = load_match(store, found.key)
        assert kept.mirrored == found.mirrored == turned
        assert (kept.point_map == truth).mean() > 0.99, pair.name
        for name in ("score", "margin", "mirror_margin", "coverage", "orientation", "doubts"):
            assert getattr(kept, name) == getattr(found, name)
        assert (kept.ambiguous, kept.convincing) == (found.ambiguous, found.convincing)


def test_a_match_that_no_pairs_connect_is_kept_as_one(run):
    store, report = run
    kept = load_match(store, report.completed[0][1].record.key)
    loose = replace(kept, unconnected=True)
    assert _restored(_arrays(loose)).doubts == loose.doubts == (*kept.doubts, "unconnected")
    older = {**_arrays(loose), "judged": _arrays(loose)["judged"][:-2]}
    assert _restored(older).doubts == kept.doubts


def test_a_restored_match_is_the_match(run):
    options = QUICK.options
    store, report = run
    (_, found), *_ = report.completed
    kept = load_match(store, found.record.key)
    a, b = (store.record(name, PLAN) for name in ("animal", "image"))
    sides = [sk.prepare(store.load(one.spectrum), store.shape(one.shape)) for one in (a, b)]
    expected = sk.match(*sides, options=options)
    for name, value in vars(expected).items():
        if name == "candidates":
            continue
        np.testing.assert_array_equal(getattr(kept, name), value)
    for one, other in zip(kept.candidates, expected.candidates, strict=True):
        np.testing.assert_array_equal(one.functional_map, other.functional_map)
        assert (one.score, one.mismatches, one.mirrored) == (
            *(other.score, other.mismatches, other.mirrored),
        )
    assert load_match(store, "0" * 32) is None


def test_a_second_run_searches_for_nothing_and_writes_nothing(run, mapped):
    store, first = mapped, run[1]
    pairs = find_pairs("all", store)
    before = {entry.path: entry.path.stat().st_mtime_ns for entry in store.entries()}
    again = match_all(pairs, store, matching=QUICK)
    assert (first.computed, again.computed) == (3, 0)
    assert before == {entry.path: entry.path.stat().st_mtime_ns for entry in store.entries()}
    for (_, one), (_, other) in zip(first.completed, again.completed, strict=True):
        assert one.record == other.record
    # Modes that are not there decide nothing; options do.
    more = Matching(k=90, options=QUICK.options)
    assert match_all(pairs, store, matching=more).computed == 0
    rigid = Matching(elastic=False, options=QUICK.options)
    assert match_all(pairs[:1], store, matching=rigid).computed == 1


def test_a_run_that_was_interrupted_goes_on(store):
    class StoppedError(Exception):
        pass

    def stop(done, count):
        if done == 1:
            raise StoppedError

    pairs = find_pairs("all", store)[:2]
    with pytest.raises(StoppedError):
        match_all(pairs, store, matching=QUICK, progress=stop)
    assert len(content(store)) == 1
    before = content(store)
    assert match_all(pairs, store, matching=QUICK).computed == 1
    assert before.items() <= content(store).items()


def test_a_damaged_map_is_told_of_and_made_again(mapped):
    store, pairs = mapped, find_pairs("all", mapped)
    whole = content(store)
    one, other, third = store.entries("maps")
    one.path.write_bytes(one.path.read_bytes()[:-1000])
    other.path.write_bytes(third.path.read_bytes())  # whole, but of another pair
    with pytest.raises(InvalidFileError, match="verify --remove"):
        load_match(store, one.key)
    assert [damage.path for damage in store.verify()] == [one.path, other.path]
    report = match_all(pairs, store, matching=QUICK)
    assert report.computed == 2
    assert all(any(str(entry.path) in text for text in report.replaced) for entry in (one, other))
    assert content(store) == whole


def test_pairs_that_fail_are_told_and_the_rest_goes_on(tmp_path, shapes):
    store = filled(tmp_path / "store", shapes, [*shapes])
    pairs = [
        Pair(source="animal", target="parts"),
        Pair(source="animal", target="lion"),
        Pair(source="animal", target="image"),
        Pair(source="nobody", target="image"),
    ]
    report = match_all(pairs, store, matching=QUICK)
    assert [pair.name for pair, _ in report.completed] == ["animal to image"]
    reasons = {failed.input.name: str(failed.error) for failed in report.failed}
    assert [*reasons] == ["animal to parts", "animal to lion", "nobody to image"]
    assert "be of one connected surface" in reasons["animal to parts"]
    assert reasons["animal to lion"].startswith("`target` must be the name of a shape in the stor")
    assert reasons["nobody to image"].startswith("`source` must be the name of a shape")
    for pair in pairs[:2]:
        with pytest.raises(InvalidInputError):
            match_all([pair], store, strict=True)


def test_shapes_that_are_gone_or_damaged_fail_by_themselves(store):
    prepared.cache_clear()
    spectrum = store.record("image", PLAN).spectrum
    (entry,) = (one for one in store.entries("spectra") if one.key == spectrum)
    entry.path.write_bytes(b"")
    pairs = [Pair(source="animal", target=name) for name in ("image", "shuffled")]
    report = match_all(pairs, store, matching=QUICK)
    assert [pair.target for pair, _ in report.completed] == ["shuffled"]
    assert isinstance(report.failed[0].error, InvalidFileError)
    entry.path.unlink()
    (failed,) = match_all(pairs, store, matching=QUICK).failed
    assert str(failed.error).startswith("`store` must hold the spectrum of each shape")


def test_unlike_shapes_are_not_convincing_and_no_warning_is_given(tmp_path, shapes):
    write(bumpy(), tmp_path / "bumpy.off")
    store = filled(tmp_path / "store", {**shapes, "bumpy": tmp_path / "bumpy.off"},
                   ("animal", "bumpy"))  # fmt: skip
    (_, found), *_ = match_all(find_pairs("all", store), store, matching=QUICK).completed
    assert not found.record.convincing
    assert {"score", "coverage"} & set(found.record.doubts)
    sides = [sk.read(path) for path in (shapes["animal"], tmp_path / "bumpy.off")]
    with pytest.warns(DoubtfulMatchWarning):
        sk.match(*(sk.prepare(sk.spectrum(one, 40), one) for one in sides), options=QUICK.options)


def test_several_plans_in_one_store(store, shapes):
    filled(store.path, shapes, ("animal", "image"), Plan(k=30))
    refused("store", "hold spectra of one plan, or be told of which", find_pairs, "all", store)
    pairs = find_pairs("all", store, Plan(k=30))
    assert [pair.name for pair in pairs] == ["animal to image"]
    refused("store", "hold spectra of one plan", match_all, pairs, store)
    (_, found), *_ = match_all(pairs, store, Plan(k=30), matching=QUICK).completed
    assert len(load_match(store, found.record.key).functional_map) == 30


def test_maps_go_with_the_spectra_that_they_join(mapped, monkeypatch):
    store, pairs = mapped, find_pairs("all", mapped)
    assert store.clean() == []
    for entry in store.entries("spectra"):
        if entry.key == store.record("image", PLAN).spectrum:
            entry.path.unlink()
    gone = store.clean()
    assert {path.parts[-3] for path in gone} == {"maps"}
    assert len(gone) == 2
    with monkeypatch.context() as other:
        other.setattr("spectra_kit.datasets.store.VERSION", "0.0.1")
        match_all(pairs[1:2], store, matching=QUICK)
    assert len(content(store)) == 2
    assert len(store.clean()) == 1


# --- pairs ---


def test_pairs_of_a_table(store, tmp_path):
    table = tmp_path / "pairs.csv"
    table.write_text("source,target,kind\nanimal,image,near\nimage,animal,far\n")
    pairs = find_pairs(table, store)
    assert pairs == [
        Pair(source="animal", target="image", columns={"kind": "near"}),
        Pair(source="image", target="animal", columns={"kind": "far"}),
    ]
    assert sorted(one.name for i in (1, 2, 3) for one in shard(pairs, i, 3)) == [
        *("animal to image", "image to animal")
    ]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("source,goal\na,b\n", "have columns 'source' and 'target'"),
        ("", "have columns 'source' and 'target'"),
        ("source,target\na,\n", "line 2 has not a cell for each column, or none for 'source' and"),
    ],
)
def test_tables_that_are_none_of_pairs(store, tmp_path, text, problem):
    (tmp_path / "pairs.csv").write_text(text)
    with pytest.raises(InvalidFileError, match=problem):
        find_pairs(tmp_path / "pairs.csv", store)


def test_pairs_that_cannot_be(store, tmp_path):
    (tmp_path / "pairs.csv").write_text("source,target\na,b\nb,a\na,b\n")
    twice = find_pairs(tmp_path / "pairs.csv", store)
    refused("pairs", "have names of their own, got 1", match_all, twice, store)
    with pytest.raises(InvalidFileError, match="there is no such file"):
        find_pairs(tmp_path / "none.csv", store)
    empty = SpectrumStore(tmp_path / "empty")
    refused("store", "hold spectra", find_pairs, "all", empty)
    refused("store", "hold two shapes to match", find_pairs, "all", empty, PLAN)
    refused("k", "be at least 30", Matching, k=29)
    key = store.keep_map("a", "b", {}, {"point_map": [1]})
    refused("key", "be that of a match", load_match, store, key)
    refused("how", "be what JSON can say", store.keep_map, "a", "b", {"k": object()}, {})


@pytest.mark.parametrize("order", [list, own_order])
def test_tiles_let_shapes_beprepared_once_for_many_pairs(order):
    names = [f"{i:02}" for i in range(20)]
    pairs = [Pair(source=a, target=b) for a in names for b in names if a < b]
    ordered = [pairs[i] for i in in_tiles(pairs, range(len(pairs)), order)]
    assert sorted(pair.name for pair in ordered) == sorted(pair.name for pair in pairs)
    kept, prepared = [], 0
    for pair in ordered:
        for name in (pair.source, pair.target):
            prepared += name not in kept
            kept = [*(one for one in kept if one != name), name][-KEPT:]
    assert prepared < 0.6 * len(pairs)


def test_a_table_has_a_row_for_each_pair(store, tmp_path):
    pairs = [Pair(source="animal", target="image", columns={"age": "3"})]
    report = match_all(pairs, store, matching=QUICK)
    write_table(tmp_path / "maps.csv", report)
    with (tmp_path / "maps.csv").open(newline="") as file:
        (row,) = csv.DictReader(file)
    (_, found), *_ = report.completed
    assert [*row][:3] == ["source", "target", "age"]
    assert (row["source"], row["target"], row["age"]) == ("animal", "image", "3")
    for name in ("score", "margin", "mirror_margin", "coverage", "orientation"):
        assert float(row[name]) == getattr(found.record, name)
    assert (row["mirrored"], row["convincing"]) == ("True", str(found.record.convincing))
    assert load_match(store, row["map"]).mirrored
    taken = [Pair(source="animal", target="image", columns={"score": "3"})]
    refused("columns", "not have the names of the table's own", write_table,
            tmp_path / "maps.csv", match_all(taken, store, matching=QUICK))  # fmt: skip


def test_pairs_whose_names_sound_alike_are_two(mapped, shapes):
    files = {"a": "animal", "b to c": "image", "a to b": "image", "c": "shuffled"}
    for name, file in files.items():
        complete(mapped, name, shapes[file], PLAN)
    pairs = [Pair(source="a", target="b to c"), Pair(source="a to b", target="c")]
    assert pairs[0].name == pairs[1].name
    one, other = match_all(pairs, mapped, matching=QUICK).completed
    assert one[1].record.key != other[1].record.key
    for pair, found in (one, other):
        ends = [mapped.record(name, PLAN) for name in (pair.source, pair.target)]
        assert found.record.key == QUICK.key(*ends)


def test_what_else_a_plan_keeps_makes_no_other_spectra(store, tmp_path):
    for record in list(store.records()):
        write(store.shape(record.shape), tmp_path / "shape.ply")
        more = replace(PLAN, descriptors=("hks",))
        complete(store, record.name, tmp_path / "shape.ply", more)
    report = match_all(find_pairs("all", store)[:1], store, matching=QUICK)
    assert len(report.completed) == 1
