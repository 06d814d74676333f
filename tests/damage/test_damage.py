"""Whatever is damaged, interrupted or missing: a right answer, or a clear refusal.

``pytest tests/damage --damage 10000`` runs more cases of the same sequence; see `frame`.
"""

from __future__ import annotations

import json
import os
from collections import Counter

import frame
import pytest
from frame import Case, Verdict, all_parts, part, run_part, tally


@pytest.mark.parametrize("chosen", all_parts(), ids=lambda chosen: chosen.name)
def test_damage(chosen, request, tmp_path, record_property):
    outcomes: Counter[str] = Counter()
    faults = []
    asked = request.config.getoption("damage")
    for number, outcome, message in run_part(chosen, chosen.cases(asked), tmp_path):
        outcomes[outcome] += 1
        if outcome not in frame.FINE:
            again = f"python tests/damage/frame.py {chosen.module} {chosen.name} {number}"
            faults.append(f"{outcome}: {message}\n    {again}")
    record_property("damage", json.dumps([chosen.name, outcomes]))
    shown = "\n".join(faults[:20])
    assert not faults, f"{chosen.name}: {tally(outcomes)}\n{shown}"


ENDS = {
    "right": lambda: None,
    "refused": lambda: frame.refused("as it should be"),
    "foreign": lambda: [][1],
    "crash": os.abort,
    "hang": lambda: os.read(os.pipe()[0], 1),
    "wrong": lambda: frame.wrong("an answer that is none"),
}


@part(seconds=5.0)
def every_end(case: Case) -> None:
    list(ENDS.values())[case.number]()


def test_the_frame_tells_every_outcome(tmp_path):
    """An abort and an endless wait are outcomes, after which the next case runs."""
    told = [outcome for _, outcome, _ in run_part(every_end, len(ENDS), tmp_path)]
    assert told == list(ENDS) == list(frame.OUTCOMES)


@pytest.mark.parametrize(
    ("code", "err", "outcome"),
    [
        (2, "error: no such file\n", "refused"),
        (2, "", "foreign"),
        (1, "error: this is a bug of spectra_kit\n", "foreign"),
        (2, "Traceback (most recent call last)\n", "foreign"),
        (-11, "", "crash"),
        (134, "double free\n", "crash"),
    ],
)
def test_the_frame_judges_a_command(code, err, outcome):
    with pytest.raises(Verdict) as verdict:
        frame.judge(code, err)
    assert verdict.value.outcome == outcome
    frame.judge(0, "")
