"""Completion, as a shell does it."""

import shutil
import subprocess

import pytest
from running import printed

from spectra_kit.catalogue import SOLVERS
from spectra_kit.cli.program import COMMANDS


def completed(script, folder, line):
    """What bash offers behind the last word of `line`."""
    words = line.split(" ")
    code = f"""
        source {script}
        COMP_WORDS=({" ".join(f"'{word}'" for word in words)})
        COMP_CWORD={len(words) - 1}
        $(complete -p spectra-kit | sed 's/.*-F \\([^ ]*\\) .*/\\1/')
        printf '%s\\n' "${{COMPREPLY[@]}}"
    """
    done = subprocess.run(
        ["bash", "--norc", "-c", code], cwd=folder, capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    return done.stdout.split()


@pytest.mark.parametrize(
    ("shell", "begin"), [("bash", "#"), ("zsh", "#compdef spectra-kit"), ("fish", "#")]
)
def test_every_shell_gets_a_script_that_it_can_read(shell, begin, capsys, tmp_path):
    """In bash it offers commands, options, choices and files."""
    script = tmp_path / "completion"
    script.write_text(printed(capsys, "completion", shell)[0])
    text = script.read_text()
    assert text.startswith(begin)
    assert all(name in text for name in COMMANDS)
    if not (program := shutil.which(shell)):
        pytest.skip(f"there is no {shell} on this machine")
    subprocess.run([program, "-n"], input=text, text=True, check=True)
    if shell != "bash":
        return
    (tmp_path / "deer.obj").touch()
    (tmp_path / "dear.npz").touch()
    for line, offered in (
        ("spec", {"spectrum"}),
        ("spectrum --ver", {"--verify"}),
        ("spectrum de", {"dear.npz", "deer.obj"}),
        ("spectrum demo --solver ar", {"arpack"}),
        ("spectrum demo --solver ", set(SOLVERS)),
        ("modes demo --spectrum dea", {"dear.npz"}),
        ("completion z", {"zsh"}),
    ):
        assert set(completed(script, tmp_path, f"spectra-kit {line}")) == offered
    assert set(completed(script, tmp_path, "spectra-kit ")) >= {*COMMANDS}
