"""What errors and warnings advise: every remedy has its place, and its word on the command line."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import spectra_kit
from spectra_kit.cli.words import option_of
from spectra_kit.errors import ConvergenceError, InvalidInputError

#: What no command can be told.
OF_PYTHON_ALONE = {
    'kind="cloud"',
    "max_points",
    "max_restarts",
    "max_shifts",
    "max_steps",
    "max_sweeps",
    "tol",
}


def advised() -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Where advice is given, its text, and its remedies; without those that are handed on."""
    package = Path(spectra_kit.__file__).parent
    for path in sorted(package.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call):
                continue
            given = {keyword.arg: keyword.value for keyword in node.keywords}
            remedies = given.get("remedies")
            if not isinstance(remedies, ast.Tuple) and "advice" not in given:
                continue
            if remedies is not None and not isinstance(remedies, ast.Tuple):
                continue  # `remedies=remedies`, and `advice` with it
            where = f"{path.relative_to(package)}:{node.lineno}"
            assert "advice" in given, f"{where}: remedies without advice"
            parts = [part for part in ast.walk(given["advice"]) if isinstance(part, ast.Constant)]
            yield (
                where,
                "".join(str(part.value) for part in parts),
                tuple(map(ast.literal_eval, remedies.elts)) if remedies else (),
            )


def test_advice_has_a_place_for_each_remedy_and_the_command_line_a_word() -> None:
    found = list(advised())
    assert sum(bool(remedies) for *_, remedies in found) > 10
    for where, advice, remedies in found:
        assert advice.count("{}") == len(remedies), where
        for remedy in remedies:
            assert option_of(remedy) != remedy, (where, remedy)
            assert bool(option_of(remedy)) == (remedy not in OF_PYTHON_ALONE), (where, remedy)


def test_an_alternative_without_a_word_is_left_out() -> None:
    remedies = ("max_steps", "rtol", "Arpack")
    error = ConvergenceError(
        "stopped", advice=("raise {}", "loosen {}", "use {}"), remedies=remedies
    )
    assert str(error) == "stopped; raise max_steps, loosen rtol, or use Arpack"
    assert error.told(option_of) == "stopped; loosen --rtol, or use --solver arpack"
    assert (
        InvalidInputError("gone", advice=("use {}",), remedies=("tol",)).told(option_of) == "gone"
    )
