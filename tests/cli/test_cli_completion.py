"""Completion, as a shell does it."""

import shutil
import subprocess

import pytest

from spectra_kit.cli import main
from spectra_kit.cli.options import SOLVERS
from spectra_kit.cli.story import COMMANDS


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    if not shutil.which("bash"):
        pytest.skip("there is no bash on this machine")
    path = tmp_path_factory.mktemp("shell") / "completion.bash"
    with pytest.MonkeyPatch.context() as patched, path.open("w") as file:
        patched.setattr("sys.stdout", file)
        assert main(["completion", "bash"]) == 0
    return path


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


def test_the_script_is_valid_bash(script):
    subprocess.run(["bash", "-n", script], check=True)


def test_commands_options_choices_and_files(script, tmp_path):
    (tmp_path / "deer.obj").touch()
    (tmp_path / "dear.npz").touch()
    assert completed(script, tmp_path, "spectra-kit spec") == ["spectrum"]
    assert set(completed(script, tmp_path, "spectra-kit ")) >= {c.name for c in COMMANDS}
    assert completed(script, tmp_path, "spectra-kit spectrum --ver") == ["--verify"]
    offered = completed(script, tmp_path, "spectra-kit spectrum de")
    assert sorted(offered) == ["dear.npz", "deer.obj", "demo"]
    assert set(completed(script, tmp_path, "spectra-kit spectrum demo --solver ")) >= set(SOLVERS)
    assert completed(script, tmp_path, "spectra-kit spectrum demo --solver ar") == ["arpack"]
    assert completed(script, tmp_path, "spectra-kit modes demo --spectrum dea") == ["dear.npz"]
    assert completed(script, tmp_path, "spectra-kit completion z") == ["zsh"]


@pytest.mark.parametrize(("shell", "begin"), [("zsh", "#compdef spectra-kit"), ("tcsh", "#")])
def test_other_shells(shell, begin, capsys):
    assert main(["completion", shell]) == 0
    out = capsys.readouterr().out
    assert out.startswith(begin)
    for command in COMMANDS:
        assert command.name in out
    if program := shutil.which(shell):
        subprocess.run([program, "-n"], input=out, text=True, check=True)
