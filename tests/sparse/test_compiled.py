"""Compiled loops are kept in the user's cache folder, and never stand in the way."""

import gc
import os
import re
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from numba.core.errors import TypingError
from scipy import sparse

from spectra_kit._core.compiled import compiled
from spectra_kit._core.compiling import heard_by
from spectra_kit._sparse import first_call

ROOT = Path(__file__).parents[2]
LOOPS = """
from spectra_kit._core.compiled import compiled

@compiled()
def raised(x):
    return x + {step}
"""


@pytest.fixture
def loops(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file with a loop, and a cache folder of its own."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    folder = tmp_path / "code"
    folder.mkdir()
    (folder / "loops.py").write_text(LOOPS.format(step=1))
    return folder / "loops.py"


def call(source: Path, argument: float = 1) -> tuple[float, int]:
    """Call `raised`, new as in another process: its result, and how often it was in the cache."""
    names = {"__name__": "loops"}
    exec(compile(source.read_text(), str(source), "exec"), names)
    raised = names["raised"]
    return raised(argument), len(raised.stats.cache_hits)


def kept(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


@pytest.mark.parametrize("variable", ["NUMBA_CACHE_DIR", "XDG_CACHE_HOME"])
@pytest.mark.skipif(sys.platform != "linux", reason="XDG")
def test_kept_in_the_cache_folder_alone(loops, tmp_path, monkeypatch, variable: str) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.setenv(variable, str(tmp_path / "other"))
    assert call(loops, 1.5) == (2.5, 0)
    assert call(loops, 1.5) == (2.5, 1)
    assert [path.parent for path in kept(tmp_path / "other")] == [tmp_path / "other/spectra_kit"]
    assert sorted(loops.parent.iterdir()) == [loops]  # nothing beside the source


def test_a_changed_source_finds_nothing_old(loops) -> None:
    before = loops.stat()
    assert call(loops) == (2, 0)
    loops.write_text(LOOPS.format(step=3))  # as long, and as old
    os.utime(loops, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert call(loops) == (4, 0)
    loops.write_text(LOOPS.format(step=1))  # and the way back costs nothing
    assert call(loops) == (2, 1)


def test_a_damaged_file_is_compiled_again(loops, tmp_path) -> None:
    call(loops)
    (file,) = kept(tmp_path / "cache")
    file.write_bytes(file.read_bytes()[:-7])
    assert call(loops) == (2, 0)
    assert call(loops) == (2, 1)


@pytest.mark.parametrize(
    ("variable", "value"),
    [
        ("NUMBA_CACHE_DIR", "/dev/null/cache"),  # no folder can be made there, not even by root
        ("HOME", "/dev/null"),
        ("HOME", "nowhere"),
    ],
)
def test_without_a_folder_nothing_is_kept(loops, monkeypatch, variable: str, value: str) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv(variable, value)
    assert call(loops) == (2, 0)
    assert call(loops) == (2, 0)


def test_processes_that_begin_at_once(loops, monkeypatch) -> None:
    """Of signatures of their own and one that they share, each is found by others later."""
    code = "from loops import raised as f; print(f({}), f(True))"
    path = f"{loops.parent}:{ROOT}"
    both = [
        subprocess.Popen(
            [sys.executable, "-c", code.format(x)],
            env={**os.environ, "PYTHONPATH": path},
            stdout=subprocess.PIPE,
            text=True,
        )
        for x in ("1", "1.5")
    ]
    assert [process.communicate()[0].split() for process in both] == [["2", "2"], ["2.5", "2"]]
    monkeypatch.syspath_prepend(loops.parent)
    monkeypatch.setitem(sys.modules, "loops", None)
    del sys.modules["loops"]  # and at the end, too
    assert [call(loops, x) for x in (1, 1.5, True)] == [(2, 1), (2.5, 1), (2, 1)]


def test_compiling_is_told_of_and_not_looked_through_for_garbage(loops) -> None:
    """Also where it fails; what is found is not compiled."""
    told: list[tuple[bool, bool]] = []
    with heard_by(lambda begins: told.append((begins, gc.isenabled()))):
        call(loops)
        call(loops)
        assert told == [(True, False), (False, True)]
        with pytest.raises(TypingError):
            call(loops, "text")
    assert told[2:] == [(True, False), (False, True)]
    call(loops, 1.5)
    assert len(told) == 4  # nobody asks any more


@pytest.mark.slow
def test_what_a_process_beside_compiles_is_what_a_factor_asks_for(tmp_path) -> None:
    code = (
        "from spectra_kit.geometry import sphere; import spectra_kit as sk\n"
        "sk.eigensolve(sk.robust_laplacian(sphere(subdivisions=4).geometry), 60)\n"
        "from spectra_kit._sparse._frontal_kernels import factorise, factor_columns\n"
        "from spectra_kit._sparse._lane_kernels import solve_lanes\n"
        "for loop in (factorise, factor_columns, solve_lanes):\n"
        "    print(len(loop.stats.cache_hits), len(loop.stats.cache_misses))\n"
    )
    kept_in = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    for command in (["-m", "spectra_kit._sparse.first_call"], ["-c", code]):
        told = subprocess.check_output([sys.executable, *command], env=kept_in, text=True, cwd=ROOT)
    assert told.splitlines() == ["1 0"] * 3


def test_it_runs_once_and_nothing_of_the_folder_that_the_user_is_in(tmp_path, monkeypatch) -> None:
    started = []

    class Process:
        def __init__(self, command, **_):
            started.append(command)

        def terminate(self): ...

        def wait(self): ...

    monkeypatch.setattr(first_call.subprocess, "Popen", Process)
    monkeypatch.setenv("NUMBA_NUM_THREADS", "2")
    (tmp_path / "file").touch()
    for folder in ("cache", "cache", "file"):
        monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / folder))
        with first_call.compiled_beside():
            pass
    assert len(started) == 1
    assert "-P" in started[0]


def test_what_is_found_needs_nothing_that_compiles(loops) -> None:
    code = (
        "import sys; from loops import raised as f; f(1); print('numba.np.arrayobj' in sys.modules)"
    )
    path = f"{loops.parent}:{ROOT}"
    environment = {**os.environ, "PYTHONPATH": path}
    command = [sys.executable, "-c", code]
    seen = [subprocess.check_output(command, env=environment, text=True) for _ in range(2)]
    assert seen == ["True\n", "False\n"]


def test_orders_and_factors_are_compiled_for_one_kind_of_arguments() -> None:
    """Whether an array may be written to, or an index has 32 bits or 64, would be another."""
    from spectra_kit._sparse import _degree_kernels, _frontal_kernels, _tree_kernels
    from spectra_kit._sparse.elimination import Elimination
    from spectra_kit._sparse.ldl import SparseLDL

    matrix = sparse.csr_array(np.array([[2.0, -1, 0], [-1, 2, -1], [0, -1, 2]]))
    for _ in range(2):
        SparseLDL(matrix, elimination=Elimination.of(matrix)).solve(np.ones(3))
        for part in (matrix.indptr, matrix.indices, matrix.data):
            part.flags.writeable = False
    for module in (_degree_kernels, _tree_kernels, _frontal_kernels):
        loops = [loop for loop in vars(module).values() if hasattr(loop, "signatures")]
        assert loops
        assert all(len(loop.signatures) <= 1 for loop in loops)


def test_every_compiled_loop_is_kept_like_this() -> None:
    """And stands on its own: a file is found again by its own text."""
    for path in (ROOT / "spectra_kit").rglob("*.py"):
        text = path.read_text()
        if path.name != "compiled.py":
            assert not re.search(r"\b(njit|cache=True)\b", text), path
        if "@compiled(" in text and path.name != "compiled.py":
            used = set(re.findall(r"^(?:from|import) (spectra_kit[\w.]*)", text, re.MULTILINE))
            assert used - {"spectra_kit._core.types"} == {"spectra_kit._core.compiled"}, path


def test_variables_of_the_function_around_are_refused() -> None:
    """They are no part of the text by which what was compiled is found again."""

    def adding(step: float):
        @compiled()
        def added(x):
            return x + step

        return added

    with pytest.raises(TypeError, match=r"adding.<locals>.added must not use variables"):
        adding(1.0)


def test_loops_of_others_are_compiled_as_ever() -> None:
    """Those that numba lifts out of a function have no place where they could be kept."""

    def total(n):
        found = 0
        for i in range(n):
            found += i
        return found

    assert numba.jit(forceobj=True, looplift=True)(total)(5) == 10
