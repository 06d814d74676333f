"""What a terminal shows while a command works, and that files and pipes see nothing of it."""

import os
import re
import signal
import subprocess
import sys
import time
import warnings

import pytest

from spectra_kit._core import compiling
from spectra_kit.cli import main
from spectra_kit.cli.progress import counted, say, step, telling

pytestmark = pytest.mark.skipif(os.name != "posix", reason="there are no pseudo terminals here")


class Terminal:
    """A pseudo terminal, in place of stderr inside a with block."""

    def __init__(self, patch):
        self.master, self.slave = os.openpty()
        os.set_blocking(self.master, False)
        self.patch = patch

    def __enter__(self):
        self.screen = os.fdopen(self.slave, "w", encoding="utf-8")
        self.patch.setattr(sys, "stderr", self.screen)

    def __exit__(self, *_):
        self.patch.undo()
        time.sleep(0.05)
        self.text = ""
        while True:
            try:
                self.text += os.read(self.master, 65536).decode()
            except BlockingIOError:
                break
        self.screen.close()
        os.close(self.master)


@pytest.fixture
def terminal(monkeypatch):
    return Terminal(monkeypatch)


def left_over(text):
    """The lines that stay on the screen when `text` was written to it."""
    lines = []
    for line in text.split("\n"):
        cells = ""
        for part in line.rstrip("\r").split("\r"):
            cells = part + cells[len(part) :]
        lines.append(cells.rstrip())
    return [line for line in lines if line]


def test_a_long_step_counts_the_seconds_and_says_how_many_it_took(terminal):
    """It keeps to one line, however long its text."""
    with terminal, step("work" * 50):
        time.sleep(1.05)
    text = terminal.text
    assert re.search(r"\r(work)+w?  0\.\d s", text)
    assert re.fullmatch(r"(work){50}: done in 1\.\d s", *left_over(text))
    assert 60 < max(map(len, text.partition(" s\rwork")[0].split("\r"))) <= 79
    assert "\x1b" not in text


@pytest.mark.parametrize("error", [None, KeyboardInterrupt, ValueError])
def test_a_step_that_is_short_or_fails_leaves_nothing(terminal, error):
    with terminal, pytest.raises(error or ZeroDivisionError):  # noqa: PT012
        with step("working"):
            time.sleep(0.15)
            if error:
                raise error
        raise ZeroDivisionError
    assert "working" in terminal.text
    assert left_over(terminal.text) == []


def test_a_line_that_is_interrupted_as_it_is_made_is_cleared(terminal, monkeypatch):
    def interrupted(bar):
        bar.disable = True  # so that tqdm does not clear it when it is garbage
        raise KeyboardInterrupt

    monkeypatch.setattr("tqdm.tqdm.__enter__", interrupted)
    with terminal, pytest.raises(KeyboardInterrupt), step("working"):
        pass
    assert "working" in terminal.text
    assert left_over(terminal.text) == []


def test_what_is_said_in_the_midst_of_a_step_has_a_line_of_its_own(terminal):
    with terminal, telling(quiet=False), step("working"), warnings.catch_warnings():
        time.sleep(0.15)
        say("repaired: nothing to do")
        warnings.simplefilter("always")
        warnings.warn("thin ice", stacklevel=1)
        time.sleep(0.15)
    assert left_over(terminal.text) == ["repaired: nothing to do", "warning: thin ice"]


@pytest.mark.parametrize(
    ("quiet", "seconds", "said"), [(False, 0.6, 1), (False, 0.2, 0), (True, 0.6, 0)]
)
def test_compiling_is_told_of_once_when_it_takes_long(terminal, quiet, seconds, said):
    """All loops together: none of them may take long itself."""
    with terminal, telling(quiet=quiet), step("working"):
        for _ in range(3):
            compiling.tell(True)
            time.sleep(seconds)
            compiling.tell(False)
        time.sleep(0.5)
    lines = [line for line in left_over(terminal.text) if line.startswith("compiling")]
    assert len(lines) == said


def test_counted_work_has_a_bar(terminal):
    with terminal, counted("drawing", "frame") as tell:
        for i in range(1, 5):
            time.sleep(0.12)
            tell(i, 4)
    text = terminal.text
    assert "drawing" in text
    assert re.search(r"[34]/4", text)
    assert left_over(text.replace("\x1b[A", "")) == []


def test_quiet_shows_nothing(terminal):
    with terminal, telling(quiet=True):
        with step("working"):
            time.sleep(0.15)
        with counted("drawing", "frame") as tell:
            tell(1, 1)
    assert terminal.text == ""


def test_a_command_shows_its_steps_to_a_terminal_and_its_table_to_a_pipe(terminal, capsys):
    command = ["compare", "demo", "--points", "500", "-k", "8", "--solver", "dense"]
    with terminal:
        assert main(command) == 0
    assert "making the demo" in terminal.text
    lines = [line for line in left_over(terminal.text) if not line.startswith("compiling")]
    assert all(re.search(r": done in \d+\.\d s$", line) for line in lines)
    assert "eigenvector error" in capsys.readouterr().out


def test_ctrl_c_leaves_no_line_no_traceback_and_no_file(tmp_path):
    master, slave = os.openpty()
    command = [sys.executable, "-m", "spectra_kit", "spectrum", "demo", "--points", "4000"]
    options = ["-k", "400", "--solver", "refined", "--rtol", "1e-13", "-o", "out.npz"]
    process = subprocess.Popen(
        [*command, *options], stdout=subprocess.PIPE, stderr=slave, cwd=tmp_path
    )
    os.close(slave)
    text = ""
    while not re.search(r"solving for 400[^\r]*  1\.\d s", text):  # in the midst of its sweeps
        text += os.read(master, 4096).decode()
    process.send_signal(signal.SIGINT)
    while True:
        try:
            text += os.read(master, 4096).decode()
        except OSError:  # how a terminal says that its last writer has gone
            break
    out, _ = process.communicate(timeout=60)
    os.close(master)
    assert (process.returncode, out) == (130, b"")
    assert left_over(text)[-1] == "interrupted"
    assert not any("solving" in line or "Traceback" in line for line in left_over(text))
    assert os.listdir(tmp_path) == []
