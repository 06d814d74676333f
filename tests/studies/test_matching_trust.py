"""What confidence is worth, as shipped and as fitted to one half; and scenes of several bodies."""

from dataclasses import replace

import numpy as np
import pytest
from studies.matching.scenes import kind_of, scene, scene_pairs
from studies.matching.sets import halves, make_protocol
from studies.matching.subjects import demo_subjects
from studies.matching.trust import NAMES, trust

from spectra_kit.geometry import components


@pytest.fixture
def records(tmp_path):
    """Pairs whose maps are right where they score well, which confidence does not tell; points
    that are right where edges are hardly stretched."""
    rng, made = np.random.default_rng(0), []
    shapes = [f"cat{i:02d}" for i in range(20)]
    half = halves(shapes)
    for i in range(60):
        source, target = rng.permutation([s for s in shapes if half[s] == i % 2])[:2]
        right = i % 3 > 0
        stretch = rng.uniform(0, 1, 50)
        np.savez(
            tmp_path / f"{i}.points.npz",
            seen=np.column_stack([np.full(50, 0.1), np.full(50, 0.1), stretch]),
            errors=np.where(stretch < 0.3, 1.0, 20.0),
        )
        made.append(
            {"set": "zoo", "source": source, "target": target, "direct": 2.0 if right else 30.0,
             "score": rng.uniform(0.1, 0.2) if right else rng.uniform(0.3, 0.5),
             "discontinuity": 0.001, "margin": 1.2, "coverage": 1.4, "confidence": 0.6,
             "files": [f"{i}.npy", f"{i}.points.npz"]}
        )  # fmt: skip
    return made


def counted(row, name):
    return [int(number) for number in row[name].split("/")]


def test_every_map_and_point_is_counted_once(tmp_path, records):
    maps, points, *_ = trust(tmp_path, records)
    assert [maps[name] for name in NAMES] == ["0/0"] * 3 + ["40/60"] + ["0/0"] * 2
    assert maps["wrong below 0.5"] == "0/20"
    assert maps["right below 0.5"] == "0/40"
    total = np.sum([counted(points, name) for name in NAMES], axis=0)
    with_errors = [np.load(tmp_path / f"{i}.points.npz")["errors"] for i in range(60)]
    assert total.tolist() == [(np.concatenate(with_errors) <= 8).sum(), 3000]


def test_what_is_fitted_to_one_half_tells_the_other(tmp_path, records):
    rows = {(row["of"], row["by"]): row for row in trust(tmp_path, records)}
    maps = rows["maps of one half", "as fitted to the other"]
    assert maps["wrong below 0.5"] == "20/20"
    assert counted(maps, "right below 0.5")[0] == 0
    points = rows["points of these", "as fitted to the other"]
    right, said = counted(points, "0.9-1")
    assert right > 0.95 * said > 0.5 * counted(points, "right below 0.5")[1]


def test_without_wrong_maps_nothing_is_fitted(tmp_path, records):
    right = [record for record in records if record["direct"] < 8]
    assert [row["by"] for row in trust(tmp_path, right)] == ["as shipped"] * 2


def test_pairs_of_halves_are_of_one_half():
    zoo = demo_subjects(500, poses=4)
    ring = replace(zoo["creature0"], name="ring0")
    pairs = make_protocol("halves", [*zoo.values(), ring]).pairs
    assert set(pairs) == {
        ("creature0", "creature2"), ("creature2", "creature0"),
        ("creature1", "creature3"), ("creature3", "creature1"),
    }  # fmt: skip
    every = make_protocol("halves", [*zoo.values(), ring], one_class=True).pairs
    assert set(every) - set(pairs) == {
        *(("ring0", f"creature{i}") for i in (0, 2)), *((f"creature{i}", "ring0") for i in (0, 2))
    }  # fmt: skip


NAMED = [
    f"{kind}{i}"
    for kind in ("tr_reg_00", "hippo", "cow", "a-lion-in-its-habitat", "dog")
    for i in range(4)
]


def test_scenes_have_others_of_the_same_kinds_and_every_second_a_body_without_partner():
    pairs = scene_pairs(NAMED, 20)
    assert pairs[:5] == scene_pairs(NAMED, 5)
    for i, pair in enumerate(pairs):
        kinds, others = ({kind_of(name) for name in side} for side in pair)
        assert len(kinds) == len(others) == 2
        assert ("person" in kinds) == (i % 2 == 0)
        assert "person" in others
        assert len(kinds & others) == 2 - i % 2
        assert not set(pair.source) & set(pair.target)
        assert set(pair.source) | set(pair.target) <= set(NAMED)
    zoo = demo_subjects(500, poses=3)
    made = scene(list(zoo.values()))
    assert [part.mesh.area for part in components(made)] == pytest.approx([1, 1, 1])
