"""Which shapes of a store are matched: all with all, or the pairs of a table."""

from __future__ import annotations

import os
from collections.abc import Mapping
from itertools import combinations
from pathlib import Path

from spectra_kit._core.checked import checked
from spectra_kit._core.version import VERSION
from spectra_kit.datasets.files import ShapeRecord
from spectra_kit.datasets.inputs import Pair, rows_of
from spectra_kit.datasets.plan import Plan
from spectra_kit.datasets.store import SpectrumStore
from spectra_kit.errors import InvalidInputError

ALL = "all"
_ENDS = ("source", "target")


@checked
def find_pairs(
    pairs: str | os.PathLike[str], store: SpectrumStore, plan: Plan | None = None
) -> list[Pair]:
    """Return the pairs that are to be matched.

    Parameters
    ----------
    pairs : "all" or path-like
        All shapes of the store with all others, each two once: the one whose name comes first is
        the source. Or a CSV file with columns ``source`` and ``target``, names in the store;
        further columns are handed on to the table.
    store : SpectrumStore
        Whose shapes.
    plan : Plan, optional
        By which they were computed, where the store has several.

    Returns
    -------
    list of Pair
        In the order of the names, or of the file.

    Raises
    ------
    InvalidInputError
        If the store has fewer than two shapes, or several plans and none is given.
    InvalidFileError
        If the file is not there, or has no such columns, or an empty cell in them; or two columns
        of one name, or one of none.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import spectra_kit as sk
    >>> folder = Path(tempfile.mkdtemp())
    >>> for i in range(3):
    ...     sk.geometry.write(sk.geometry.creature(600, seed=i), folder / f"{i}.off")
    >>> store, plan = sk.datasets.SpectrumStore(folder / "store"), sk.datasets.Plan(k=12)
    >>> for i in range(3):
    ...     _ = sk.datasets.complete(store, f"animal{i}", folder / f"{i}.off", plan)
    >>> [pair.name for pair in sk.datasets.find_pairs("all", store)]
    ['animal0 to animal1', 'animal0 to animal2', 'animal1 to animal2']
    """
    return pairs_of(pairs, store, None if plan is None else plan.facts)


def pairs_of(
    pairs: str | os.PathLike[str], store: SpectrumStore, facts: Mapping[str, object] | None
) -> list[Pair]:
    """Return the pairs that are to be matched: see `find_pairs`."""
    if os.fspath(pairs) == ALL:
        names = sorted(records_of(store, facts))
        if len(names) < 2:
            raise InvalidInputError("store", "hold two shapes to match", len(names))
        return [Pair(source=a, target=b) for a, b in combinations(names, 2)]
    return [
        Pair(
            source=row["source"],
            target=row["target"],
            columns={key: cell for key, cell in row.items() if key not in _ENDS},
        )
        for row in rows_of(Path(pairs), "pairs", _ENDS)
    ]


def records_of(store: SpectrumStore, facts: Mapping[str, object] | None) -> dict[str, ShapeRecord]:
    """Return what a store holds of each name under a plan, or under the only one it has."""
    meant = only_plan(store) if facts is None else _of_spectra(facts)
    return {one.name: one for one in store.records() if _of_spectra(one.facts) == meant}


def only_plan(store: SpectrumStore, k: int | None = None) -> Mapping[str, object]:
    """Return by what a store's spectra were computed, those with k modes if that is told.

    Those of other releases do not count, nor what else was kept beside them.
    """
    plans = list[Mapping[str, object]]()
    for one in store.records():
        meant = _of_spectra(one.facts)
        if meant not in plans and k in (None, meant["k"]) and meant["release"] == VERSION:
            plans.append(meant)
    if not plans:
        kind = "spectra" if k is None else f"spectra of {k} modes"
        raise InvalidInputError("store", f"hold {kind}", "none", advice="compute them first")
    if len(plans) > 1:
        modes = sorted({str(one["k"]) for one in plans})
        differ = [name for name in plans[0] if any(one[name] != plans[0][name] for one in plans)]
        raise InvalidInputError(
            "store",
            "hold spectra of one plan, or be told of which",
            f"those of {len(plans)}, which differ in {', '.join(differ)} ({' and '.join(modes)}"
            " modes)",
            advice="name it by {}",
            remedies=("plan",),
        )
    return plans[0]


def _of_spectra(facts: Mapping[str, object]) -> dict[str, object]:
    """Return those facts of a plan that decide spectra."""
    return {name: fact for name, fact in facts.items() if name not in ("descriptors", "operators")}
