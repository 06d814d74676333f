"""The yardstick: what it gathers of tables, and the picture of ratios."""

import numpy as np
import pytest
from studies.plots import plot_ratios
from studies.recipes import MADE
from studies.yardstick import Timed, _distances, _rows, _solves, _walks

from spectra_kit.show import Page


def test_a_row_tells_the_geometric_mean_and_the_worst_shape():
    timed = [Timed("a", "eigsh", "cow", 1.0, 8.0, 0.1), Timed("a", "eigsh", "fox", 2.0, 4.0)]
    (row,) = _rows([*timed])
    assert row["times sooner"] == pytest.approx(4)  # of 8 and 2
    assert (row["worst"], row["worst on"], row["seconds there"]) == (2.0, "fox", 2.0)
    assert (row["shapes"], row["noise"]) == (2, 0.1)


def test_solves_stand_beside_each_peer_that_is_installed(tmp_path):
    (tmp_path / "eigensolvers").mkdir()
    lines = ["contender,problem,seconds", "operator,cow,", "eigsh,cow,4", "eigsh,cow,5"]
    lines += ["lanczos,cow,1", "lanczos,cow,1", "neo (cuda),cow,0.5"]
    (tmp_path / "eigensolvers" / "eigensolvers.csv").write_text("\n".join(lines) + "\n")
    rows = [("eigsh", 4.5), ("lanczos", 1.0), ("neo (cuda)", 0.5)]
    table = [{"method": name, "problem": "cow", "seconds": s} for name, s in rows]
    exact, neo = _solves({"Every problem": table}, tmp_path)
    assert exact == ("96 modes exact", "eigsh", "cow", 1.0, 4.5, 0.125)  # 4.5 is 1/8 above 4
    assert neo.task == "96 modes by NEO (cuda)"


def test_distances_and_walks_are_taken_from_their_tables():
    ours = {"mesh": "cow", "solver": "automatic, no modes", "least": 1.0, "seconds": 1.5}
    many = {"many: least": 2.0, "many: seconds": 2.0}
    theirs = {"mesh": "cow", "solver": "libigl", "least": 3.0, "seconds": 3.0}
    (first,) = _distances({"Seconds to the first field": [ours | many, theirs]})  # none for many
    assert first == ("a first distance field", "libigl", "cow", 1.0, 3.0, 0.5)
    walked = {"Paths": [{"model": "cow", "search s": 1.0, "libigl s": 2.0}]}
    found = list(_walks({"Vectors": [], "Curvature": [], **walked}))
    assert found == [Timed("distances for paths", "libigl", "cow", 1.0, 2.0)]


def test_made_members_need_no_data():
    assert not any(member.missing for member in MADE.values())
    assert {member.kind for member in MADE.values()} == {"mesh", "cloud"}


def test_ratios_are_drawn_from_the_worst_to_the_mean():
    ratios = {"modes": (4.0, 0.5), "fields": (2.0, 2.0)}
    panel = plot_ratios.__wrapped__(ratios, page=Page(dpi=60)).axes[0]
    worst, mean, one = panel.lines
    np.testing.assert_array_equal(mean.get_xydata(), [(4, 0), (2, -1)])
    np.testing.assert_array_equal(worst.get_xdata(), [0.5, 2])
    assert list(one.get_xdata()) == [1, 1]
    assert [text.get_text() for text in panel.get_yticklabels()] == ["modes", "fields"]
