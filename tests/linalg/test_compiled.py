"""Compiled loops are kept in the user's cache folder, and never stand in the way."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from spectra_kit.linalg.compiled import compiled

ROOT = Path(__file__).parents[2]
LOOPS = """
from spectra_kit.linalg.compiled import compiled

@compiled()
def raised(x):
    return x + {step}
"""


def start(code: str, folder: Path, **environment: str) -> subprocess.Popen[str]:
    """Run code in a process that finds modules in `folder`, with the caches told."""
    kept = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    return subprocess.Popen(
        [sys.executable, "-B", "-c", code],
        cwd=folder,
        env={**kept, "PYTHONPATH": f"{folder}:{ROOT}", **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def printed(process: subprocess.Popen[str]) -> str:
    out, err = process.communicate()
    assert process.returncode == 0, err
    return out.strip()


def call(argument: str, folder: Path, **environment: str) -> tuple[str, int]:
    """Call `raised` in a process; return its result, and how often it was found in the cache."""
    code = f"from loops import raised; print(raised({argument}), len(raised.stats.cache_hits))"
    result, hits = printed(start(code, folder, **environment)).rsplit(maxsplit=1)
    return result, int(hits)


@pytest.fixture
def loops(tmp_path: Path) -> Path:
    folder = tmp_path / "code"
    folder.mkdir()
    (folder / "loops.py").write_text(LOOPS.format(step=1))
    return folder


@pytest.mark.parametrize(
    ("variable", "below"),
    [("NUMBA_CACHE_DIR", "spectra_kit"), ("XDG_CACHE_HOME", "spectra_kit")]
    if sys.platform == "linux"
    else [("NUMBA_CACHE_DIR", "spectra_kit")],
)
def test_kept_in_the_cache_folder_alone(loops, tmp_path, variable: str, below: str) -> None:
    cache = {variable: str(tmp_path / "cache")}
    assert call("1.5", loops, **cache) == ("2.5", 0)
    assert call("1.5", loops, **cache) == ("2.5", 1)
    files = sorted(p for p in (tmp_path / "cache").rglob("*") if p.is_file())
    assert [p.parent for p in files] == [tmp_path / "cache" / below]
    assert sorted(loops.iterdir()) == [loops / "loops.py"]  # nothing beside the source


def test_a_changed_source_finds_nothing_old(loops, tmp_path) -> None:
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    source = loops / "loops.py"
    before = source.stat()
    assert call("1", loops, **cache) == ("2", 0)
    source.write_text(LOOPS.format(step=3))  # as long, and as old
    os.utime(source, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert call("1", loops, **cache) == ("4", 0)
    source.write_text(LOOPS.format(step=1))  # and the way back costs nothing
    assert call("1", loops, **cache) == ("2", 1)


def test_a_damaged_file_is_compiled_again(loops, tmp_path) -> None:
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    call("1", loops, **cache)
    (kept,) = (tmp_path / "cache" / "spectra_kit").iterdir()
    kept.write_bytes(kept.read_bytes()[:-7])
    assert call("1", loops, **cache) == ("2", 0)
    assert call("1", loops, **cache) == ("2", 1)


@pytest.mark.parametrize(
    "environment",
    [
        {"NUMBA_CACHE_DIR": "/dev/null/cache"},  # no folder can be made there, not even by root
        {"HOME": "/dev/null"},
        {"HOME": "nowhere"},
    ],
    ids=str,
)
def test_without_a_folder_nothing_is_kept(loops, environment) -> None:
    assert call("1", loops, **environment) == ("2", 0)
    assert sorted(loops.iterdir()) == [loops / "loops.py"]


def test_processes_that_begin_at_once(loops, tmp_path) -> None:
    """Of signatures of their own and one that they share, each process finds its own later."""
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    code = "from loops import raised as f; print(f({0}), f(True), len(f.stats.cache_hits))"
    both = [start(code.format(x), loops, **cache) for x in ("1", "1.5")]
    for process in both:
        process.wait()
    assert [printed(p).split()[:2] for p in both] == [["2", "2"], ["2.5", "2"]]
    for x, result in (("1", "2"), ("1.5", "2.5")):
        assert printed(start(code.format(x), loops, **cache)).split() == [result, "2", "2"]


def test_every_compiled_loop_is_kept_like_this() -> None:
    """And stands on its own: a file is found again by its own text."""
    for path in (ROOT / "spectra_kit").rglob("*.py"):
        text = path.read_text()
        if path.name != "compiled.py":
            assert not re.search(r"\b(njit|cache=True)\b", text), path
        if "@compiled(" in text and path.name != "compiled.py":
            used = set(re.findall(r"^(?:from|import) (spectra_kit[\w.]*)", text, re.MULTILINE))
            assert used == {"spectra_kit.linalg.compiled"}, path


def test_variables_of_the_function_around_are_refused() -> None:
    """They are no part of the text by which what was compiled is found again."""

    def adding(step: float):
        @compiled()
        def added(x):
            return x + step

        return added

    with pytest.raises(TypeError, match=r"adding.<locals>.added must not use variables"):
        adding(1.0)
