"""The commands that compute modes and show them: as numbers, as pictures, swinging."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import spectra_kit as sk
from spectra_kit._core.validate import check_count, check_positive, quantity
from spectra_kit.cli import options, solving, tables
from spectra_kit.cli.inputs import prepare
from spectra_kit.cli.output import check_output, tell
from spectra_kit.cli.progress import counted, say, step
from spectra_kit.errors import ConvergenceError, OutOfMemoryError


@dataclass(frozen=True, kw_only=True)
class SpectrumOptions(options.OnOne, options.Solver, options.Resolution):
    """Compute the lowest eigenvalues and eigenfunctions, each with a certificate of accuracy."""

    examples = (
        "spectrum bunny.obj -o bunny.npz",
        "spectrum bunny.obj --solver refined --rtol 1e-8 --verify",
        f"spectrum {options.DEMO} -k 24 --accuracy 1e-3 --picture spectrum.png",
    )
    keys = "input, geometry, eigenvalues, certificate, provenance, verdict, output, picture"

    k: options.Count = 96
    solver: options.SolverName = "automatic"
    output: options.Output | None = None
    """write the spectrum to this .npz file (default: none)"""
    picture: Path | None = None
    """draw eigenvalues, Weyl's law and residuals (.png, .pdf, .svg) (default: none)"""
    modes: options.Indices | None = None
    """modes to show, counted from 0 (default: a handful)"""
    verify: bool = False
    """count the eigenvalues to prove that no mode was missed (a few factorisations)"""


@dataclass(frozen=True, kw_only=True)
class Shown(options.OnOne, options.Spared, options.Turned):
    """Modes that are drawn: those asked for are solved for, unless they are saved."""

    k: options.Count | None = None
    """number of modes (default: as many as are shown)"""
    solver: options.SolverName = "automatic"


@dataclass(frozen=True, kw_only=True)
class ModesOptions(Shown, options.Resolution):
    """Draw modes on the surface, with their zero lines, eigenvalues and residuals."""

    examples = (
        "modes bunny.obj -o modes.png",
        "modes bunny.obj --spectrum bunny.npz --modes 1,5,20",
        f"modes {options.DEMO} -o modes.pdf --dpi 600",
    )
    keys = "input, geometry, eigenvalues, certificate, provenance, verdict, modes, picture"

    output: options.Output = Path("modes.png")
    """the picture (.png, .pdf, .svg)"""
    modes: options.Indices | None = None
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
        f"animate {options.DEMO} -o modes.mp4 --width 720 --fps 30",
    )
    keys = "input, geometry, eigenvalues, certificate, provenance, verdict, modes, animation"

    output: options.Output = Path("modes.gif")
    """the animation: .gif, or .mp4 where imageio-ffmpeg is installed"""
    modes: options.Indices | None = None
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
    check_output(output, [".npz"], asked.inputs)
    check_output(asked.picture, options.PICTURES, asked.inputs)
    solving.check_solvers(asked, asked.solver)
    k = asked.k
    shown = solving.shown_modes(asked.modes, (*solving.SHOWN, k - 1), k)
    geometry, laplacian = prepare(asked)
    try:
        found = solving.solve(laplacian, k, asked.solver, asked)
    except (ConvergenceError, OutOfMemoryError) as error:
        if output and error.partial is not None:
            _rescue(error, output.with_suffix(".partial.npz"))
        raise
    if asked.verify and (found.certificate is None or found.certificate.level != "verified"):
        with step("counting eigenvalues"):
            found = sk.verify(found, laplacian)
    if output:
        with step(f"writing {output}"):
            found.save(output)

    def draw(path: Path) -> None:
        from spectra_kit.show.spectra import free_boundary

        sk.show.plot_spectrum(
            found,
            path=path,
            free_boundary=free_boundary(geometry, found),
            page=tables.page(asked, geometry),
        )

    tell(
        asked,
        {**_record(asked, geometry, found), "output": output},
        tables.headline(asked.file, geometry, laplacian),
        tables.modes_table(found, shown),
        tables.certificate_lines(found),
        *([f"spectrum: {output}"] if output else []),
        draw=draw,
        kept=f"the spectrum {output} is whole" if output else "the numbers are whole",
    )


def _record(
    asked: options.OnOne, geometry: "sk.geometry.Geometry", spectrum: "sk.Spectrum"
) -> tables.Record:
    """What the commands tell of modes."""
    return {
        "input": asked.file,
        "geometry": tables.geometry_record(geometry),
        **tables.spectrum_record(spectrum),
    }


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

    def draw(
        geometry: "sk.geometry.Geometry", spectrum: "sk.Spectrum", shown: tuple[int, ...]
    ) -> None:
        with step(f"drawing {quantity(len(shown), 'mode')}"):
            sk.show.plot_modes(
                geometry,
                spectrum,
                path=asked.output,
                modes=shown,
                nodal_lines=not asked.no_lines,
                columns=asked.columns,
                view=asked.view,
                page=tables.page(asked, geometry),
            )

    _show(asked, "picture", options.PICTURES, 12, draw)


def animate(asked: AnimateOptions) -> None:
    """Let modes swing, one after the other."""
    check_positive("--seconds", asked.seconds)
    check_count("--fps", asked.fps, low=1)
    check_count("--width", asked.width, low=16)

    def draw(
        geometry: "sk.geometry.Geometry", spectrum: "sk.Spectrum", shown: tuple[int, ...]
    ) -> None:
        with counted(f"drawing {quantity(len(shown), 'mode')}", "frame") as progress:
            sk.show.animate_modes(
                geometry,
                spectrum,
                path=asked.output,
                modes=shown,
                seconds_per_mode=asked.seconds,
                fps=asked.fps,
                width=asked.width,
                view=asked.view,
                progress=progress,
            )

    _show(asked, "animation", (".gif", ".mp4"), 6, draw)


def _show(
    asked: ModesOptions | AnimateOptions,
    what: str,
    suffixes: tuple[str, ...],
    usual: int,
    draw: Callable[["sk.geometry.Geometry", "sk.Spectrum", tuple[int, ...]], None],
) -> None:
    """Draw modes, those asked for or the first that are not constant, and say where they are."""
    check_output(asked.output, suffixes, asked.inputs)
    for mode in asked.modes or ():
        check_count("--modes", mode, low=0)
    if asked.spectrum:
        solving.refuse_solving(asked)
    solving.check_solvers(asked, asked.solver)
    geometry, laplacian = prepare(asked)
    if asked.spectrum:
        spectrum = solving.saved(asked.spectrum, laplacian)
        if asked.k is not None:
            spectrum = spectrum.truncate(asked.k)
    else:
        needed = max(asked.modes) + 1 if asked.modes else usual + laplacian.kernel_dimension
        k = min(needed, len(laplacian.free)) if asked.k is None else asked.k
        spectrum = solving.solve(laplacian, max(k, 1), asked.solver, asked)
    first = spectrum.n_zero_modes
    shown = solving.shown_modes(asked.modes, range(first, first + usual), spectrum.k)
    draw(geometry, spectrum, shown)
    tell(
        asked,
        {**_record(asked, geometry, spectrum), "modes": shown, what: asked.output},
        tables.headline(asked.file, geometry, laplacian),
        tables.modes_table(spectrum, shown),
        f"{what}: {asked.output}",
    )
