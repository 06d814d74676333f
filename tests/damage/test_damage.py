"""Whatever is damaged, interrupted or missing: a right answer, or a clear refusal.

``pytest tests/damage --damage 10000`` runs more cases of the same sequence; see `frame`.
"""

from __future__ import annotations

import json
import os
from collections import Counter, defaultdict

import pytest
from frame import FINE, HERE, Case, Verdict, judge, outcomes, part, parts_of, wrong


@pytest.mark.slow
@pytest.mark.parametrize("module", sorted(path.stem for path in HERE.glob("parts_*.py")))
def test_damage(module, request, record_property):
    asked = request.config.getoption("damage")
    cases = [(p.name, number) for p in parts_of(module).values() for number in p.numbers(asked)]
    counts, faults = defaultdict(Counter), []
    for (name, number), (outcome, message) in zip(cases, outcomes(module, cases), strict=True):
        counts[name][outcome] += 1
        if outcome not in FINE:
            again = f"python tests/damage/frame.py {module} {name} {number}"
            faults.append(f"{outcome}: {message}\n    {again}")
    for name, found in counts.items():
        record_property("damage", json.dumps([name, found]))
    assert not faults, "\n".join(faults[:20])


ENDS = {
    "right": lambda: None,
    "refused": lambda: judge(2, "error: no such file\n"),
    "foreign": lambda: [][1],
    "crash": os.abort,
    "hang": lambda: os.read(os.pipe()[0], 1),
    "wrong": lambda: wrong("an answer that is none"),
}


@part(seconds=2.0)
def every_end(case: Case) -> None:
    list(ENDS.values())[case.number]()


def test_the_frame_tells_every_outcome():
    """An abort and an endless wait are outcomes, after which the next case runs."""
    cases = [("every_end", number) for number in range(len(ENDS))]
    assert [outcome for outcome, _ in outcomes("test_damage", cases)] == list(ENDS)
    for code, err, outcome in (
        (2, "", "foreign"),
        (1, "error: this is a bug of spectra_kit\n", "foreign"),
        (0, "Traceback (most recent call last)\n", "foreign"),
        (-11, "", "crash"),
        (134, "double free\n", "crash"),
    ):
        with pytest.raises(Verdict) as verdict:
            judge(code, err)
        assert verdict.value.outcome == outcome
    judge(0, "")
