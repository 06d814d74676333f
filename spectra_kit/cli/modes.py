"""The commands that compute modes and show them: as numbers, as pictures, swinging."""

from dataclasses import dataclass
from pathlib import Path

from spectra_kit._core.validate import check_count, check_positive, quantity
from spectra_kit.cli import tables
from spectra_kit.cli.inputs import prepare
from spectra_kit.cli.options import (
    DEMO,
    PICTURES,
    Count,
    Indices,
    OnOne,
    Output,
    Resolution,
    Solver,
    SolverName,
    Spared,
    Turned,
)
from spectra_kit.cli.output import check_output, tell, tell_with_picture
from spectra_kit.cli.progress import counted, say, step
from spectra_kit.cli.solving import (
    SHOWN,
    check_solvers,
    refuse_solving,
    saved,
    shown_modes,
    solve,
)
from spectra_kit.eigen import Spectrum, verify
from spectra_kit.errors import ConvergenceError, OutOfMemoryError
from spectra_kit.geometry import Geometry
from spectra_kit.operators import Laplacian


@dataclass(frozen=True, kw_only=True)
class SpectrumOptions(OnOne, Solver, Resolution):
    """Compute the lowest eigenvalues and eigenfunctions, each with a certificate of accuracy."""

    examples = (
        "spectrum bunny.obj -o bunny.npz",
        "spectrum bunny.obj --solver refined --rtol 1e-8 --verify",
        f"spectrum {DEMO} -k 24 --accuracy 1e-3 --picture spectrum.png",
    )
    keys = "input, geometry, eigenvalues, certificate, provenance, verdict, output, picture"

    k: Count = 96
    solver: SolverName = "automatic"
    output: Output | None = None
    """write the spectrum to this .npz file (default: none)"""
    picture: Path | None = None
    """draw eigenvalues, Weyl's law and residuals (.png, .pdf, .svg) (default: none)"""
    modes: Indices | None = None
    """modes to show, counted from 0 (default: a handful)"""
    verify: bool = False
    """count the eigenvalues to prove that no mode was missed (a few factorisations)"""


@dataclass(frozen=True, kw_only=True)
class Shown(OnOne, Spared, Turned):
    """Modes that are drawn: those asked for are solved for, unless they are saved."""

    k: Count | None = None
    """number of modes (default: as many as are shown)"""
    solver: SolverName = "automatic"


@dataclass(frozen=True, kw_only=True)
class ModesOptions(Shown, Resolution):
    """Draw modes on the surface, with their zero lines, eigenvalues and residuals."""

    examples = (
        "modes bunny.obj -o modes.png",
        "modes bunny.obj --spectrum bunny.npz --modes 1,5,20",
        f"modes {DEMO} -o modes.pdf --dpi 600",
    )
    keys = "input, geometry, eigenvalues, certificate, provenance, verdict, modes, picture"

    output: Output = Path("modes.png")
    """the picture (.png, .pdf, .svg)"""
    modes: Indices | None = None
    """modes to show, counted from 0 (default: the first 12 that are not constant)"""
    columns: int | None = None
    """modes in a row (default: as fits)"""
    no_lines: bool = False
    """leave the zero lines out"""


@dataclass(frozen=True, kw_only=True)
class AnimateOptions(Shown):
    """Let modes swing, one after the other, in a GIF or an MP4."""

    examples = (
        "animate bunny.obj -o modes.gif",
        "animate bunny.obj --spectrum bunny.npz --modes 7",
        f"animate {DEMO} -o modes.mp4 --width 720 --fps 30",
    )
    keys = "input, geometry, eigenvalues, certificate, provenance, verdict, modes, animation"

    output: Output = Path("modes.gif")
    """the animation: .gif, or .mp4 where imageio-ffmpeg is installed"""
    modes: Indices | None = None
    """modes to show, counted from 0 (default: the first 6 that are not constant)"""
    seconds: float = 2.0
    """that each mode is shown"""
    fps: int = 20
    """frames per second"""
    width: int = 480
    """pixels"""


def spectrum(asked: SpectrumOptions) -> None:
    """Compute the lowest modes, show a few, save all, draw their eigenvalues."""
    output = asked.output
    if output:
        check_output(output, [".npz"], asked.inputs)
    if asked.picture:
        check_output(asked.picture, PICTURES, asked.inputs)
    check_solvers(asked, asked.solver)
    k = asked.k
    shown = shown_modes(asked.modes, (*SHOWN, k - 1), k)
    geometry, laplacian = prepare(asked)
    try:
        found = solve(laplacian, k, asked.solver, asked)
    except (ConvergenceError, OutOfMemoryError) as error:
        if output and error.partial is not None:
            _rescue(error, output.with_suffix(".partial.npz"))
        raise
    if asked.verify and (found.certificate is None or found.certificate.level != "verified"):
        with step("counting eigenvalues"):
            found = verify(found, laplacian)
    if output:
        with step(f"writing {output}"):
            found.save(output)

    def draw(path: Path) -> None:
        from spectra_kit.show import Page, plot_spectrum
        from spectra_kit.show.spectra import free_boundary

        page = Page(tables.title(asked.file, geometry), dpi=asked.dpi)
        plot_spectrum(found, path=path, free_boundary=free_boundary(geometry, found), page=page)

    tell_with_picture(
        asked,
        {
            "input": asked.file,
            "geometry": tables.geometry_record(geometry),
            **tables.spectrum_record(found),
            "output": output,
        },
        tables.headline(asked.file, geometry, laplacian),
        tables.modes_table(found, shown),
        tables.certificate_lines(found),
        *([f"spectrum: {output}"] if output else []),
        picture=asked.picture,
        draw=draw,
        kept=f"the spectrum {output} is whole" if output else "the numbers are whole",
    )


def _rescue(error: ConvergenceError | OutOfMemoryError, path: Path) -> None:
    """Save what there is of a spectrum that was not finished."""
    partial = error.partial
    partial.save(path)
    reached = error.n_converged if isinstance(error, ConvergenceError) else partial.k
    say(f"{quantity(partial.k, 'mode')}, of which {reached} converged: {path}")


def modes(asked: ModesOptions) -> None:
    """Draw modes on one page."""
    if asked.columns is not None:
        check_count("--columns", asked.columns, low=1)
    geometry, laplacian, spectrum, shown = _to_show(asked, PICTURES, 12)
    from spectra_kit.show import Page, View, plot_modes

    with step(f"drawing {quantity(len(shown), 'mode')}"):
        plot_modes(
            geometry,
            spectrum,
            path=asked.output,
            modes=shown,
            nodal_lines=not asked.no_lines,
            columns=asked.columns,
            view=View(asked.upwards, asked.turn),
            page=Page(tables.title(asked.file, geometry), dpi=asked.dpi),
        )
    _tell(asked, "picture", geometry, laplacian, spectrum, shown)


def animate(asked: AnimateOptions) -> None:
    """Let modes swing, one after the other."""
    check_positive("--seconds", asked.seconds)
    check_count("--fps", asked.fps, low=1)
    check_count("--width", asked.width, low=16)
    geometry, laplacian, spectrum, shown = _to_show(asked, (".gif", ".mp4"), 6)
    from spectra_kit.show import View, animate_modes

    with counted(f"drawing {quantity(len(shown), 'mode')}", "frame") as progress:
        animate_modes(
            geometry,
            spectrum,
            path=asked.output,
            modes=shown,
            seconds_per_mode=asked.seconds,
            fps=asked.fps,
            width=asked.width,
            view=View(asked.upwards, asked.turn),
            progress=progress,
        )
    _tell(asked, "animation", geometry, laplacian, spectrum, shown)


def _to_show(
    asked: ModesOptions | AnimateOptions, suffixes: tuple[str, ...], usual: int
) -> tuple[Geometry, Laplacian, Spectrum, tuple[int, ...]]:
    """Return modes, and which to show: those asked for, else the first that are not constant."""
    check_output(asked.output, suffixes, asked.inputs)
    for mode in asked.modes or ():
        check_count("--modes", mode, low=0)
    if asked.spectrum:
        refuse_solving(asked)
    check_solvers(asked, asked.solver)
    geometry, laplacian = prepare(asked)
    if asked.spectrum:
        spectrum = saved(asked.spectrum, laplacian)
        if asked.k is not None:
            spectrum = spectrum.truncate(asked.k)
    else:
        needed = max(asked.modes) + 1 if asked.modes else usual + laplacian.kernel_dimension
        k = min(needed, len(laplacian.free)) if asked.k is None else asked.k
        spectrum = solve(laplacian, max(k, 1), asked.solver, asked)
    first = spectrum.n_zero_modes
    which = shown_modes(asked.modes, range(first, first + usual), spectrum.k)
    return geometry, laplacian, spectrum, which


def _tell(
    asked: ModesOptions | AnimateOptions,
    what: str,
    geometry: Geometry,
    laplacian: Laplacian,
    spectrum: Spectrum,
    shown: tuple[int, ...],
) -> None:
    """Say what was drawn and where it is."""
    found = {
        "input": asked.file,
        "geometry": tables.geometry_record(geometry),
        **tables.spectrum_record(spectrum),
    }
    tell(
        asked,
        {**found, "modes": shown, what: asked.output},
        tables.headline(asked.file, geometry, laplacian),
        tables.modes_table(spectrum, shown),
        f"{what}: {asked.output}",
    )
