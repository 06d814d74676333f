"""Errors of the command line: a line that says what to do, an exit code, nothing half written."""

import io
import json
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from conftest import creature
from running import printed, refusal

from spectra_kit import Refined, eigensolve, robust_laplacian, show, spectrum
from spectra_kit.cli import info, main
from spectra_kit.cli.output import as_json, check_folder, together
from spectra_kit.cli.program import COMMANDS
from spectra_kit.errors import InvalidInputError, OutOfMemoryError
from spectra_kit.geometry import PointCloud, TriangleMesh, rectangle, sphere, write

OTHERS = ("batch", "match-all", "store", "completion")  # of many files, of a folder, of none
NAMES = [name for name in COMMANDS if name not in OTHERS]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    ball = sphere(subdivisions=2).geometry
    write(ball, folder / "ball.off")
    write(ball.as_cloud(), folder / "cloud.ply")
    write(PointCloud([[0.0, 0, 0]]), folder / "point.ply")
    write(rectangle(n=100).geometry, folder / "sheet.off")
    spectrum(sphere(subdivisions=1).geometry, 4).save(folder / "other.npz")
    (folder / "empty.off").touch()
    (folder / "text.docx").write_text("words")
    (folder / "sub").mkdir()
    return folder


@pytest.fixture
def inside(folder, monkeypatch):
    monkeypatch.chdir(folder)


def run_by(monkeypatch, function, *options):
    """Run a command that does what `function` does."""
    monkeypatch.setattr(info, "info", function)
    return main(["info", "demo", *options])


@pytest.mark.parametrize("name", NAMES)
def test_every_command_refuses_bad_files_in_one_line(name, folder, inside, capsys):
    before = sorted(os.listdir(folder))
    second = {"match": ["ball.off"], "similar": ["."], "label": ["ball.off"]}.get(name, [])
    second = ["ball.off", "ball.off"] if name == "carry" else second
    source = ["--source", "0"] if name in ("geodesic", "path") else []
    for file, message in (
        ("bal.off", "bal.off: there is no such file; did you mean 'ball.off'?"),
        ("none.off", f"none.off: there is no such file; looked from {os.getcwd()}\n"),
        ("sub", "sub: this is a folder, expected a file; name one in it"),
        ("empty.off", "empty.off: the file is empty"),
        ("-", "/dev/stdin: pipes are not read, expected a file whose name ends in its format (o"),
        ("text.docx", "cannot read the format '.docx'; what meshio, PyVista or trimesh read"),
    ):
        assert message in refusal(capsys, name, file, *second, *source)
    assert main([name, "none.off", *second, *source, "--debug"]) == 2
    assert capsys.readouterr().err.startswith("Traceback (most recent call last)")
    assert sorted(os.listdir(folder)) == before


BALL = "ball.off"
DIRICHLET = ("--boundary", "dirichlet")
GEODESIC = ("geodesic", BALL, "--source", "0")
AT_A_FACE = ("geodesic", BALL, "--face")


@pytest.mark.parametrize(
    ("message", "arguments"),
    [
        ("must be at most the number of free points", ("spectrum", BALL, "-k", "700")),
        ("`-k` must be in [1, 162], got 700", ("compare", BALL, "-k", "700")),
        ("`-k` must be at least 1, got 0", ("modes", BALL, "-k", "0")),
        ("`--modes` must be in [0, 3], got 4", ("spectrum", BALL, "-k", "4", "--modes", "4")),
        ("`--modes` must be at least 0, got -1", ("modes", BALL, "--modes", "-1")),
        ("`--columns` must be at least 1, got 0", ("modes", BALL, "--columns", "0")),
        ("`--seconds` must be positive", ("animate", BALL, "--seconds", "0")),
        ("`--max-points` must be at least 4, got 2", ("explore", BALL, "--max-points", "2")),
        ("`--port` must be in [0, 65535]", ("explore", BALL, "--serve", "--port", "70000")),
        ("`--turn` must be a finite number", ("modes", BALL, "-k", "3", "--turn", "nan")),
        ("got cotan, which needs a mesh", ("spectrum", "cloud.ply", "--operator", "cotan")),
        ("`--cloud` must sample a mesh, got", ("spectrum", "cloud.ply", "--cloud", "100")),
        ("`--cloud` must be at least 1, got 0", ("spectrum", BALL, "--cloud", "0")),
        ("`--cloud` must fit into 64 bits, got 1000", ("info", BALL, "--cloud", str(10**30))),
        ("not enough memory", ("info", BALL, "--cloud", "90000000000000")),
        ("`--boundary` must be neumann on what", ("spectrum", BALL, *DIRICHLET)),
        ("`--boundary` must be neumann on what", ("spectrum", "cloud.ply", *DIRICHLET)),
        ("got automatic; choose one of those by --solver", ("spectrum", BALL, "--rtol", "1e-4")),
        ("got lanczos and dense", ("compare", BALL, "--solver", "dense", "--rtol", "1e-4")),
        ("must be one of", ("spectrum", BALL, "--solver", "neo", "--weights", "none")),
        ("must be in [500, 5000000], got 10", ("spectrum", "demo", "--points", "10")),
        ("must be in [10, 2400], got 0", ("modes", BALL, "-k", "4", "--dpi", "0")),
        # What has no effect as things are.
        (
            "`--device` must go with automatic, cascade and neo",
            ("spectrum", BALL, "--solver", "arpack", "--device", "cuda"),
        ),
        (
            "`--accuracy` must go with automatic, got arpack",
            ("spectrum", BALL, "--solver", "arpack", "--accuracy", "1e-3"),
        ),
        ("`--accuracy` must be less than 1", ("modes", BALL, "--accuracy", "2")),
        (
            "--accuracy has no effect on modes",
            ("modes", BALL, "--accuracy", ".1", "--spectrum", "x.npz"),
        ),
        ("`--rtol` must go with ", ("match", BALL, BALL, "--rtol", "1e-4")),
        ("--solver has no effect", ("animate", BALL, "--spectrum", "x.npz", "--solver", "dense")),
        ("--no-browser has no effect without --serve", ("explore", BALL, "--no-browser")),
        ("--rtol has no effect on modes of", ("modes", BALL, "--spectrum", "x.npz", "--rtol", "1")),
        ("--against has no effect", ("compare", BALL, "--spectrum", "x.npz", "--against", "dense")),
        ("--port has no effect without --serve", ("explore", BALL, "--port", "8000")),
        ("--points has no effect on files; name 'demo'", ("info", BALL, "--points", "900")),
        ("--dpi has no effect without a picture; name one", ("spectrum", BALL, "--dpi", "600")),
        # Distances.
        ("distances need at least one source; name some by --source, --at", GEODESIC[:2]),
        ("`--source` must be in [0, 162), got 162", (*GEODESIC, "162")),
        ("begin with the number of a face, got 1.5", (*AT_A_FACE, "1.5", "1", "0", "0")),
        ("must be in [0, 320), got 5000", (*AT_A_FACE, "5000", "1", "0", "0")),
        ("name places by --at instead", (*AT_A_FACE, "0", "1", "0", "0", "--repair")),
        ("FacePoint", ("geodesic", "cloud.ply", *AT_A_FACE[2:], "0", "1", "0", "0")),
        ("name places by --at instead", (*GEODESIC, "--cloud", "100")),
        ("`--farthest` must be at least 0, got -1", ("geodesic", BALL, "--farthest", "-1")),
        ("`--farthest` must be in [0, 162], got 163", ("geodesic", BALL, "--farthest", "163")),
        ("`-k` must be at least 1", (*GEODESIC, "--solver", "arpack", "-k", "0")),
        ("-k has no effect without modes; choose what solves for them", (*GEODESIC, "-k", "9")),
        ("--weights has no effect without", (*GEODESIC, "--weights", "x")),
        ("`--poisson-rtol` must be less than 1", (*GEODESIC, "--poisson-rtol", "1")),
        ("on a direct solver", (*GEODESIC, "--method", "direct", "--poisson-rtol", "1e-9")),
        ("`--spacing` must be positive", (*GEODESIC, "--spacing", "0")),
        ("must have the 162 points", (*GEODESIC, "--spectrum", "other.npz")),
        ("--method projected needs modes", (*GEODESIC, "--method", "projected")),
        (
            "`--method direct` must be given no modes",
            (*GEODESIC, "--method", "direct", "--solver", "neo"),
        ),
        (
            "`--heat-boundary` must be neumann with",
            (*GEODESIC, "--heat-boundary", "average", "--compare"),
        ),
        (
            "must not all lie on the boundary of",
            ("geodesic", "sheet.off", "--source", "0", "--heat-boundary", "dirichlet"),
        ),
        ("--up has no effect with --no-pictures", (*GEODESIC, "--no-pictures", "--up", "y")),
    ],
    ids=lambda part: part[0] if isinstance(part, tuple) else "",
)
def test_what_makes_no_sense_is_refused(message, arguments, folder, inside, capsys):
    before = sorted(os.listdir(folder))
    assert message in refusal(capsys, *arguments)
    assert sorted(os.listdir(folder)) == before


@pytest.mark.parametrize("name", NAMES)
def test_numbers_without_sense_are_refused(name, folder, capsys, tmp_path, monkeypatch):
    """With the name of the option."""
    monkeypatch.chdir(tmp_path)
    files = [str(folder / BALL)] * (2 if name == "match" else 1)
    option = {"info": "--cloud", "geodesic": "--farthest"}.get(name, "-k")
    for wrong in ("nan", "-1", "1e30", "", str(10**30), "spam"):
        assert main([name, *files, option, wrong]) == 2
        assert option in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "option", "suffix", "known"),
    [
        ("spectrum", "-o", ".npz", ".npz"),
        ("spectrum", "--picture", ".png", ".png or .pdf or .svg"),
        ("modes", "-o", ".png", ".png or .pdf or .svg"),
        ("animate", "-o", ".gif", ".gif or .mp4"),
        ("compare", "-o", ".png", ".png or .pdf or .svg"),
        ("explore", "-o", ".html", ".html or .htm"),
    ],
)
def test_outputs_are_checked_before_the_work(name, option, suffix, known, folder, capsys, tmp_path):
    ball = folder / "ball.off"
    bad = tmp_path / "out.doc"
    assert f"must be a {known} file, got" in refusal(capsys, name, ball, option, bad)
    nowhere = tmp_path / "no" / f"out{suffix}"
    assert "there is no folder" in refusal(capsys, name, ball, option, nowhere)
    (tmp_path / f"dir{suffix}").mkdir()
    taken = tmp_path / f"dir{suffix}"
    assert "a folder has that name" in refusal(capsys, name, ball, option, taken)
    assert os.listdir(tmp_path) == [f"dir{suffix}"]


@pytest.mark.skipif(not hasattr(os, "setresuid"), reason="there are no such rights here")
def test_a_folder_without_rights_is_told_before_the_work(capsys):
    with tempfile.TemporaryDirectory() as name:  # not in a folder that only its owner may enter
        closed = Path(name)
        closed.chmod(0o555)
        superuser = os.getuid() == 0
        if superuser:  # who may write everywhere
            os.setresuid(65534, 65534, 0)
        try:
            message = refusal(capsys, "spectrum", "demo", "-o", closed / "out.npz")
        finally:
            if superuser:
                os.setresuid(0, 0, 0)
            closed.chmod(0o755)
    assert "is not yours to write to; name another place" in message


@pytest.mark.skipif(not os.path.exists("/proc/self"), reason="there is no /proc here")
def test_a_file_that_cannot_be_made_has_its_own_name(folder, capsys):
    """The superuser too cannot write there, though he has the right to."""
    ball = folder / "ball.off"
    for place, command in (
        ("/proc/foo.npz", ("spectrum", ball, "-k", "4")),
        ("/proc/foo", ("geodesic", ball, "--source", "0", "--no-pictures")),
    ):
        message = refusal(capsys, *command, "-o", place)
        assert message.startswith(f"error: {place}: ") or "is not yours to write" in message


def test_an_output_never_replaces_an_input(capsys, tmp_path):
    write(sphere(subdivisions=1).geometry, tmp_path / "ball.npz")
    before = (tmp_path / "ball.npz").read_bytes()
    again = ("spectrum", tmp_path / "ball.npz", "-k", 4, "-o", tmp_path / "ball.npz")
    assert "`output` must not replace an input, got" in refusal(capsys, *again)
    assert (tmp_path / "ball.npz").read_bytes() == before
    for k in (4, 6):  # another output is replaced
        printed(capsys, *again[:3], k, "-o", tmp_path / "modes.npz")
    assert np.load(tmp_path / "modes.npz")["eigenvalues"].shape == (6,)
    assert sorted(os.listdir(tmp_path)) == ["ball.npz", "modes.npz"]


def test_exit_codes(bumpy_laplacian, capsys, monkeypatch):
    def stalls(_):
        eigensolve(bumpy_laplacian, 30, Refined(max_sweeps=1, rtol=1e-14))

    def starves(_):
        raise OutOfMemoryError("Refined(): 9 modes do not fit into memory")

    def is_interrupted(_):
        raise KeyboardInterrupt

    def breaks(_):
        return [][1]

    bug = "error: this is a bug of spectra_kit: IndexError: list index out of range; please report"
    for function, code, message in (
        (stalls, 3, "error: Refined("),
        (starves, 3, "error: Refined(): 9 modes do not fit into memory\n"),
        (is_interrupted, 130, "interrupted\n"),
        (breaks, 1, bug),
    ):
        assert run_by(monkeypatch, function) == code
        assert capsys.readouterr().err.startswith(message)
    assert run_by(monkeypatch, stalls, "--debug") == 3
    assert "ConvergenceError" in capsys.readouterr().err
    assert run_by(monkeypatch, breaks, "--debug") == 1
    assert "in breaks" in capsys.readouterr().err


def test_a_single_point_has_no_modes_and_can_be_looked_at(folder, capsys):
    refusal(capsys, "spectrum", folder / "point.ply", "-k", 1)
    assert "all points coincide" in printed(capsys, "info", folder / "point.ply")[0]


def test_a_reader_that_leaves_early_is_no_error():
    command = [sys.executable, "-m", "spectra_kit", "modes", "--help"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.close()
    assert process.stderr.read() == b""
    process.stderr.close()
    assert process.wait() == 0


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full here")
@pytest.mark.parametrize(
    ("command", "code", "err", "unbuffered"),
    [
        ("modes --help >&-", 0, "", ""),
        ("modes --help >/dev/full", 2, "error: standard output: no space left on device", ""),
        ("modes --help >/dev/full", 2, "error: standard output: no space left on device", "1"),
        ("fly 2>&-", 2, "", ""),
        ("fly 2>/dev/full", 2, "", "1"),
        ("info none.off <&- >&-", 2, "error: none.off: there is no such file; looked from", ""),
    ],
)
def test_closed_and_full_streams(folder, command, code, err, unbuffered):
    program = f"{sys.executable} -m spectra_kit {command}"
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    environment["PYTHONUNBUFFERED"] = unbuffered
    done = subprocess.run(
        ["sh", "-c", program], cwd=folder, env=environment, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout) == (code, "")
    assert done.stderr.startswith(err)
    assert len(done.stderr.splitlines()) == bool(err)


@pytest.mark.skipif(sys.platform != "linux", reason="names are any bytes on Linux alone")
@pytest.mark.parametrize(
    ("command", "output", "title"),
    [
        ("spectrum", "--picture=a.svg", "b\\xff\\xfel, 162 points"),
        ("explore", "-o=a.html", r"b\\xff\\xfel"),
    ],
)
def test_names_of_files_may_be_any_bytes(
    command, output, title, folder, tmp_path, monkeypatch, capsysbinary
):
    monkeypatch.chdir(tmp_path)
    name = os.fsdecode(b"b\xff\xfel.off")
    Path(name).write_bytes((folder / "ball.off").read_bytes())
    options = ["--solver", "none"] if command == "explore" else []
    monkeypatch.setattr(sys, "argv", ["spectra-kit", command, name, "-k", "4", *options, output])
    assert main() == 0
    assert b"b\xff\xfel.off: mesh" in capsysbinary.readouterr().out
    assert title in Path(output.partition("=")[2]).read_text(encoding="utf-8")


def write_result(results, run):
    with together(results, replacing=["picture.png"]) as part:
        for name in ("report.json", "a.npy", "z.npy"):  # wherever it stands in the alphabet
            (part / name).write_text(run)
        if run == "interrupted":
            raise KeyboardInterrupt


def files_of(results):
    return {path.name: path.read_text() for path in results.iterdir()}


@pytest.mark.parametrize("renames", [0, 1, 2])
def test_a_report_never_stands_beside_numbers_of_another_run(tmp_path, monkeypatch, renames):
    """Whatever rename is the last before the power fails; signals wait until all are done."""
    results, real, done = tmp_path / "results", os.replace, []

    def fails(source, target):
        if len(done) == renames:
            raise OSError("the power fails")
        done.append(real(source, target))

    write_result(results, "old")
    (results / "picture.png").write_text("old")
    with pytest.raises(KeyboardInterrupt):
        write_result(results, "interrupted")
    assert set(files_of(results)) == {"report.json", "a.npy", "z.npy", "picture.png"}
    assert set(files_of(results).values()) == {"old"}
    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", fails)
        with pytest.raises(OSError, match="the power fails"):
            write_result(results, "new")
    assert not {"report.json", "picture.png"} & set(files_of(results))
    real_mkdir = Path.mkdir

    def interrupted(path, *arguments, **options):
        if path.name == "results":
            signal.raise_signal(signal.SIGINT)
        return real_mkdir(path, *arguments, **options)

    monkeypatch.setattr(Path, "mkdir", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_result(results, "newer")
    assert files_of(results) == dict.fromkeys(("report.json", "a.npy", "z.npy"), "newer")
    assert os.listdir(tmp_path) == ["results"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes here")
def test_a_folder_with_a_pipe_in_place_of_an_output_is_refused(tmp_path):
    os.mkfifo(tmp_path / "report.json")
    with pytest.raises(InvalidInputError, match=r"got a pipe or a device as report.json; name"):
        check_folder(tmp_path, ["report.json"], ["report.json"], [])


def test_saved_modes_must_be_of_this_geometry_and_operator(folder, capsys, tmp_path):
    ball, saved, other = folder / "ball.off", tmp_path / "ball.npz", tmp_path / "other.off"
    mesh, page = sphere(subdivisions=2).geometry, tmp_path / "page.html"
    eigensolve(robust_laplacian(mesh), 6).save(saved)
    command = ("--spectrum", saved, "--solver", "none", "-o", page)
    out, _ = printed(capsys, "explore", ball, *command, "-k", "5")
    assert "5 modes on all 162 points" in out
    page.unlink()
    something_else = f"{saved}: holds modes of something else"
    for wrong in (
        creature(500),
        TriangleMesh(mesh.points * [1, 1, 1.01], mesh.faces),
        TriangleMesh(mesh.points[::-1], 161 - mesh.faces),  # the same, in another order
    ):
        write(wrong, other)
        assert something_else in refusal(capsys, "explore", other, *command)
    knn = refusal(capsys, "explore", ball, *command, "--operator", "knn")
    assert something_else in knn
    assert "leave --spectrum out" in knn
    assert not page.exists()
    assert "there is no such file" in refusal(
        capsys, "modes", ball, "--spectrum", tmp_path / "none.npz"
    )
    assert "not a whole spectrum file" in refusal(capsys, "modes", ball, "--spectrum", ball)


@pytest.mark.parametrize(
    ("command", "key"),
    [
        (("spectrum", "--picture", "x.png", "--dpi", "0"), "eigenvalues"),
        (("compare", "--solver", "dense", "-o", "x.png", "--dpi", "0"), "comparison"),
    ],
)
def test_a_drawing_that_fails_keeps_the_numbers(
    command, key, folder, capsys, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    name, *options = command
    for form in ((), ("--json",)):
        assert main([name, str(folder / "ball.off"), "-k", "4", *options, *form]) == 2
        out, err = capsys.readouterr()
        assert err.startswith("the numbers are whole, but not drawn: x.png\nerror: `")
        if form:
            told = json.loads(out)
            assert told[key]
            assert told["picture"] is None
        else:
            assert "largest relative residual" in out
            assert "picture" not in out
    assert os.listdir() == []


def test_numbers_are_out_before_the_drawing_begins(folder, monkeypatch):
    """Whatever becomes of the process then: what is printed is not left in a buffer."""
    printed_before, pipe = [], io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(pipe))
    monkeypatch.setattr(
        show, "plot_spectrum", lambda *_, **__: printed_before.append(pipe.getvalue())
    )
    assert main(["spectrum", str(folder / "ball.off"), "-k", "4", "--picture", "x.png"]) == 0
    assert b"largest relative residual" in printed_before[0]


def test_json_is_objects_line_by_line_and_lists_of_anything_else_on_one():
    record = {
        "words": ["a[0, 1]", "b\n  {c}", 'd "e", ['],
        "rows": np.array([[0.5, np.nan], [2.0, 3.0]]),
        "parts": [{"path": Path("x.png"), "none": []}, 1],
        "empty": {},
    }
    assert as_json(record).splitlines() == [
        "{",
        r"""  "words": ["a[0, 1]", "b\n  {c}", "d \"e\", ["],""",
        """  "rows": [[0.5, null], [2.0, 3.0]],""",
        """  "parts": [""",
        "    {",
        """      "path": "x.png",""",
        """      "none": []""",
        "    },",
        "    1",
        "  ],",
        """  "empty": {}""",
        "}",
    ]
