"""The study of what maps carry: of a shape onto itself, nothing is lost."""

import pytest
from studies.matching.carry import carried
from studies.matching.subjects import demo_subjects


def test_a_shape_onto_itself_loses_nothing():
    one = demo_subjects(600)["creature0"]
    found = carried(one, one)
    for name in ("map", "forth", "back", "texture"):
        assert found[name] == pytest.approx(0, abs=1e-4), name
    assert found["IoU"] == 1
    assert found["angle"] < 1
    assert found["undefined"] < 0.01  # at sources, from which distances have no direction
    assert 0.8 < found["right"] < 1
