"""Spectra for the commands: solved for, or taken from a file."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import spectra_kit as sk
from spectra_kit._core.validate import check_count, quantity
from spectra_kit.catalogue import SOLVERS
from spectra_kit.cli.inputs import of_file
from spectra_kit.cli.options import NETWORK, Solver, refuse_given
from spectra_kit.cli.progress import step
from spectra_kit.cli.words import listed
from spectra_kit.errors import InvalidInputError

# Both sides of a comparison are solved for a few modes more: pushed-out modes are found again,
# and a cluster that k cuts is known as one.
EXTRA = 6
SHOWN = (0, 1, 2, 5, 10, 25, 50)  # of a table, and the last
_SAME = (10.0, 1e-6)  # residuals of a saved mode may grow by this factor and this much
_TOLD = ("accuracy", "rtol", "start", *NETWORK)  # what only some solvers may be told


def check_solvers(asked: Solver, *names: str) -> None:
    """Refuse options that none of these solvers takes, and values that they refuse themselves."""
    if asked.k is not None:
        check_count("-k", asked.k, low=1)
    for option in _TOLD:
        takers = [name for name in SOLVERS if _takes(name, option, asked)]
        if getattr(asked, option) != getattr(Solver, option) and not set(names) & set(takers):
            got = listed([*dict.fromkeys(names)])
            raise InvalidInputError(
                f"--{option}",
                f"go with {listed(takers)}",
                got,
                advice="choose one of those by --solver, or leave it out",
            )
    for name in names:
        make_solver(name, asked, 1)


def _fields(name: str) -> dict[str, Any]:
    """Return what a solver may be told, and the defaults."""
    return {field.name: field.default for field in dataclasses.fields(SOLVERS[name].made_by)}


def _takes(name: str, option: str, asked: Solver) -> bool:
    """Whether a solver, or the subspace that it is to begin with, takes an option."""
    known = _fields(name)
    starts = "start" in known or known.get("subspace", ...) is None
    if option == "start":
        return starts
    return option in known or (option in NETWORK and starts and asked.start == "neo")


def make_solver(name: str, asked: Solver, k: int) -> sk.eigen.Eigensolver:
    """Return the solver of a name for k modes, or as many as were asked for, told what it takes."""
    known, k = _fields(name), asked.k or k
    told = {
        option: value
        for option in ("accuracy", "rtol", "seed", *NETWORK)
        if option in known and (value := getattr(asked, option)) is not None
    }
    if name == "fourier":
        told["subspace"] = sk.eigen.subspaces.AmbientFourier(seed=asked.seed)
    elif asked.start and (begin := known.keys() & {"subspace", "start"}):
        told[begin.pop()] = _start(asked.start, asked, k)
    return SOLVERS[name](**told)  # type: ignore[no-any-return]


def _start(name: str, asked: Solver, k: int) -> sk.eigen.subspaces.Subspace:
    """Return the subspace of a name, large enough for k modes and a few more."""
    if name == "neo":
        return sk.Neo(**{option: getattr(asked, option) for option in NETWORK}).subspace
    if name == "random":
        return sk.eigen.subspaces.RandomBasis(m=k + max(k // 2, 2 * EXTRA), seed=asked.seed)
    from spectra_kit.eigen.base import plane_waves

    return dataclasses.replace(plane_waves(k), seed=asked.seed)


def solve(laplacian: sk.Laplacian, k: int, name: str, asked: Solver) -> sk.Spectrum:
    """Solve for `k` modes by the solver of a name."""
    solver = make_solver(name, asked, k)
    with step(f"solving for {quantity(k, 'mode')} by {name}"):
        return sk.eigensolve(laplacian, k, solver)


def refuse_solving(asked: Solver) -> None:
    """Refuse options of solvers where modes come from a file."""
    refuse_given(asked, ("solver", *_TOLD), "on modes of a file; leave --spectrum out")


def saved(path: Path, laplacian: sk.Laplacian) -> sk.Spectrum:
    """Read a spectrum, and make sure by its residuals that it is one of this operator."""
    wrong = "holds modes of something else"
    hint = "give the file and the options it was made with, or leave --spectrum out"
    with step(f"reading {path}"):
        spectrum = sk.Spectrum.load(path)
        with of_file(path):
            try:
                certified = spectrum.certify(laplacian)
            except InvalidInputError as error:
                raise InvalidInputError(f"{wrong}: {error}", advice=hint) from error
    now, then = certified.certificate, spectrum.certificate
    if then is None or now is None:
        return certified
    factor, slack = _SAME
    if (now.relative_residuals > factor * then.relative_residuals + slack).any():
        with of_file(path):
            raise InvalidInputError(
                f"{wrong}: their relative residuals were up to"
                f" {then.relative_residuals.max():.1e} and are {now.relative_residuals.max():.1e}"
                f" by {laplacian.operator}",
                advice=hint,
            )
    return spectrum


def shown_modes(asked: Sequence[int] | None, usual: Iterable[int], k: int) -> tuple[int, ...]:
    """The modes to show: those asked for, else the usual ones, up to k."""
    if asked is not None:
        return tuple(check_count("--modes", i, low=0, high=k - 1) for i in asked)
    return tuple(sorted({i for i in usual if i < k})) or (k - 1,)
