"""Output files: whole or not at all, with the rights of the old one, and nothing left behind."""

import os
import shutil
import signal
import stat
import subprocess
import sys
import threading
from pathlib import Path

import pytest
import torch

from spectra_kit import Spectrum, eigensolve, robust_laplacian, write
from spectra_kit._core.files import atomic_path, temporary_folder
from spectra_kit.datasets.table import write as write_rows
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import sphere
from spectra_kit.learn import files as learning_files

posix = pytest.mark.skipif(os.name != "posix", reason="pipes and rights are those of POSIX")


def put(path, text):
    with atomic_path(path) as part:
        part.write_text(text)


@posix
@pytest.mark.parametrize("mode", [0o600, 0o444])
def test_rights_are_kept(tmp_path, mode):
    path, umask = tmp_path / "secret.txt", os.umask(0o022)
    try:
        put(path, "old")
        assert stat.S_IMODE(path.stat().st_mode) == 0o644  # those of any new file
        path.chmod(mode)
        with atomic_path(path) as part:
            assert stat.S_IMODE(part.stat().st_mode) == 0o600  # not shown to others meanwhile
            part.write_text("new")
    finally:
        os.umask(umask)
    assert stat.S_IMODE(path.stat().st_mode) == mode
    assert path.read_text() == "new"


@pytest.mark.skipif(not hasattr(os, "getuid") or os.getuid() != 0, reason="only root gives away")
def test_the_owner_is_kept(tmp_path):
    path = tmp_path / "file.txt"
    put(path, "old")
    os.chown(path, 1234, 2345)
    put(path, "new")
    assert (path.stat().st_uid, path.stat().st_gid) == (1234, 2345)


@posix
@pytest.mark.parametrize("linked", [False, True])
def test_a_pipe_is_written_to_and_stays_one(tmp_path, linked):
    pipe = tmp_path / "pipe.npz"
    os.mkfifo(pipe)
    if linked:
        (tmp_path / "link.npz").symlink_to(pipe)
    got = []
    reader = threading.Thread(target=lambda: got.append(pipe.read_bytes()))
    reader.start()
    spectrum = eigensolve(robust_laplacian(sphere(subdivisions=1).geometry), 4)
    spectrum.save(tmp_path / ("link.npz" if linked else "pipe.npz"))
    reader.join(timeout=60)
    assert pipe.is_fifo()
    (tmp_path / "file.npz").write_bytes(got[0])
    assert (Spectrum.load(tmp_path / "file.npz").eigenvalues == spectrum.eigenvalues).all()
    assert len(os.listdir(tmp_path)) == 2 + linked  # nothing temporary


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full here")
def test_a_link_to_a_device_is_written_through(tmp_path):
    full, link = Path("/dev/full"), tmp_path / "full.off"
    if os.getuid() == 0:  # who could replace that of the machine
        full = tmp_path / "device"
        os.mknod(full, stat.S_IFCHR | 0o666, os.stat("/dev/full").st_rdev)
    link.symlink_to(full)
    with pytest.raises(OSError, match="No space left on device") as error:
        write(sphere(subdivisions=1).geometry, link)
    assert error.value.filename == str(link)
    assert stat.S_ISCHR(full.stat().st_mode)
    assert link.is_symlink()


@pytest.mark.parametrize("name", ["é" * 125 + "1.off", "a." + "b" * 253])
def test_names_may_be_as_long_as_the_file_system_allows(tmp_path, name):
    put(tmp_path / name, "text")
    assert os.listdir(tmp_path) == [name]
    with pytest.raises(OSError, match="File name too long"):
        put(tmp_path / ("n" + name), "text")


def test_a_loop_of_links_is_replaced(tmp_path):
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    put(tmp_path / "loop", "text")
    assert (tmp_path / "loop").read_text() == "text"


WAITS = """
import sys, time
from pathlib import Path
from spectra_kit._core.files import atomic_path, temporary_folder
folder = Path(sys.argv[1])
with temporary_folder(folder) as inner, atomic_path(folder / "good.txt") as part:
    part.write_text("half")
    (inner / "file").write_text("half")
    print("ready", flush=True)
    time.sleep(60)
"""


@posix
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_no_temporary_file_outlives_a_signal(tmp_path, name):
    put(tmp_path / "good.txt", "good")
    root = Path(__file__).parents[2]
    process = subprocess.Popen(
        [sys.executable, "-c", WAITS, str(tmp_path)], stdout=subprocess.PIPE, text=True, cwd=root
    )
    assert process.stdout.readline() == "ready\n"
    assert len(os.listdir(tmp_path)) == 3
    process.send_signal(getattr(signal, name))
    process.communicate(timeout=60)
    assert process.returncode == -getattr(signal, name)  # died of it, as who sent it expects
    assert os.listdir(tmp_path) == ["good.txt"]
    assert (tmp_path / "good.txt").read_text() == "good"


@posix
def test_handlers_of_others_are_left_alone(tmp_path):
    def mine(number, frame):
        raise AssertionError

    before = signal.signal(signal.SIGTERM, mine)
    try:
        with atomic_path(tmp_path / "a.txt") as part:
            assert signal.getsignal(signal.SIGTERM) is mine
            part.write_text("text")
    finally:
        signal.signal(signal.SIGTERM, before)
    with temporary_folder() as folder:
        assert signal.getsignal(signal.SIGTERM) is not before
        (folder / "file").touch()
    assert signal.getsignal(signal.SIGTERM) is before
    assert not folder.exists()


def test_a_temporary_folder_that_cannot_be_made(tmp_path):
    shutil.rmtree(tmp_path)
    with pytest.raises(OSError, match="No such file"), temporary_folder(tmp_path):
        pass
    with pytest.raises(InvalidInputError, match="does not exist"):
        put(tmp_path / "file.txt", "text")


@posix
@pytest.mark.parametrize("written", ["file", "spectrum", "labeller", "table", "page"])
def test_a_full_disk_is_told_with_the_file(tmp_path, written):
    """Not with one that nobody has heard of, and not with none."""
    resource = pytest.importorskip("resource", reason="limits of files are Unix's")
    modes = eigensolve(robust_laplacian(sphere(subdivisions=2).geometry), 12)
    path = tmp_path / {"spectrum": "a.npz", "page": "a.png"}.get(written, "a.txt")
    write_it = {
        "file": lambda: put(path, "text" * 10_000),
        "spectrum": lambda: modes.save(path),
        "labeller": lambda: learning_files.write(path, {}, {"a": torch.zeros(9_999)}),
        "table": lambda: write_rows(path, ["a"], [{"a": "text"}] * 9_999),
        "page": lambda: modes.plot(path),
    }[written]
    write_it()
    before, (_, hard) = path.read_bytes(), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (5_000, hard))
    try:
        with pytest.raises(OSError, match="File too large") as error:
            write_it()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
    assert error.value.filename == str(path)
    assert str(path) in str(error.value)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == [path.name]
