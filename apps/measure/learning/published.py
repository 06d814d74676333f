"""DiffusionNet as its authors published it, layers and weights, on operators of several makers."""

from __future__ import annotations

import importlib
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

import spectra_kit as sk
from measure.learning.labelled import LabelledSet
from spectra_kit.errors import DoubtfulSpectrumWarning, InvalidInputError
from spectra_kit.geometry import TriangleMesh
from spectra_kit.operators import tangent_gradient

_K, _SCALES, _WIDTH, _BLOCKS, _CLASSES = 128, 16, 128, 4, 8  # of the published weights
_WEIGHTS = {
    "heat signatures": ("human_seg_hks_4x128.pth", _SCALES),
    "coordinates": ("human_seg_xyz_4x128.pth", 3),
}
INPUTS = tuple(_WEIGHTS)


class Made(NamedTuple):
    """Operators in DiffusionNet's order, and the CPU seconds of the stages that made them."""

    tensors: tuple[Tensor, ...]
    seconds: dict[str, float]


#: Takes points (n, 3) and faces (f, 3) as tensors, returns operators.
Maker = Callable[[Tensor, Tensor], Made]


@dataclass(frozen=True, eq=False)
class Published:
    """Their modules, imported from their folder as they are, and the networks by their inputs."""

    geometry: ModuleType
    networks: dict[str, torch.nn.Module]

    @classmethod
    def from_folder(cls, folder: Path) -> Published:
        """Import the package and read the weights below a folder."""
        if not (folder / "diffusion_net" / "layers.py").is_file():
            raise InvalidInputError(
                "peer", "hold diffusion_net/layers.py and pretrained/", f"neither in {folder}"
            )
        sys.path.insert(0, str(folder))
        layers, geometry = (
            importlib.import_module(f"diffusion_net.{name}") for name in ("layers", "geometry")
        )
        networks = {}
        for name, (file, channels) in _WEIGHTS.items():
            networks[name] = layers.DiffusionNet(
                *(channels, _CLASSES), C_width=_WIDTH, N_block=_BLOCKS, outputs_at="faces"
            ).eval()
            networks[name].load_state_dict(
                torch.load(folder / "pretrained" / file, map_location="cpu", weights_only=True)
            )
        return cls(geometry, networks)

    def operators(self, points: Tensor, faces: Tensor) -> Made:
        """Return the operators of their own ``get_operators``."""
        start = time.process_time()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of a constructor that torch will retire
            tensors = self.geometry.get_operators(points, faces, k_eig=_K)
        return Made(tensors, {"all": time.process_time() - start})

    @torch.no_grad()
    def labels(self, points: Tensor, faces: Tensor, tensors: tuple[Tensor, ...]) -> list[Tensor]:
        """Return the class of each face, (f,), by each network."""
        _, mass, L, evals, evecs, grad_x, grad_y = tensors
        heat = self.geometry.compute_hks_autoscale(evals, evecs, _SCALES)
        options = {"L": L, "evals": evals, "evecs": evecs, "gradX": grad_x, "gradY": grad_y}
        return [
            network(heat if name == INPUTS[0] else points, mass, faces=faces, **options).argmax(-1)
            for name, network in self.networks.items()
        ]

    def prepared(self, mesh: TriangleMesh) -> tuple[Tensor, Tensor]:
        """Return points and faces as their scripts prepare them: the farthest point is at 1."""
        points = self.geometry.normalize_positions(torch.tensor(mesh.points, dtype=torch.float32))
        return points, torch.tensor(mesh.faces)


def maker_of(solver: Any) -> Maker:
    """Return what makes our operators, with the modes of a solver."""

    def make(points: Tensor, faces: Tensor) -> Made:
        times = [time.process_time()]
        mesh = TriangleMesh(points.double().numpy(), faces.numpy())
        laplacian = sk.laplacian(mesh)
        times.append(time.process_time())
        with warnings.catch_warnings():
            # A solver may be told to stop before its modes are good: to see what they are good for.
            warnings.simplefilter("ignore", DoubtfulSpectrumWarning)
            spectrum = sk.eigensolve(laplacian, _K, solver)
        times.append(time.process_time())
        gradient = tangent_gradient(mesh, oriented=True)
        times.append(time.process_time())
        tensors = sk.interop.to_diffusion_net(spectrum, laplacian, gradient)
        times.append(time.process_time())
        stages = ("Laplacian", "modes", "gradient", "tensors")
        return Made(tensors, dict(zip(stages, np.diff(times).tolist(), strict=True)))

    return make


def makers(published: Published) -> dict[str, Maker]:
    """Return all makers by their names: theirs first, which the others are compared with."""
    predicted = sk.Neo().subspace
    return {
        "their get_operators": published.operators,
        "exact modes": maker_of(sk.Automatic()),
        "NEO, polished once": maker_of(sk.Cascade(subspace=predicted, max_steps=1)),
        "NEO, as predicted": maker_of(sk.Cascade(subspace=predicted, max_steps=0)),
    }


@dataclass(frozen=True, eq=False)
class Marks:
    """Shares of faces, in percent, on each of s test bodies."""

    maker: str
    inputs: str
    right: np.ndarray[Any, Any]  #: (s,)
    as_theirs: np.ndarray[Any, Any]  #: (s,): where both say the same, right or wrong.


def mark(
    published: Published, shapes: LabelledSet, chosen: Sequence[int], *, told: Callable[[str], None]
) -> list[Marks]:
    """Label the faces of some bodies by the operators of each maker."""
    right: dict[tuple[str, str], list[float]] = {}
    same: dict[tuple[str, str], list[float]] = {}
    for i in chosen:
        points, faces = published.prepared(shapes.meshes[i])
        truth = torch.tensor(shapes.face_labels[i])
        theirs: list[Tensor] = []
        for name, make in makers(published).items():
            found = published.labels(points, faces, make(points, faces).tensors)
            theirs = theirs or found
            for inputs, labels, other in zip(INPUTS, found, theirs, strict=True):
                right.setdefault((name, inputs), []).append(_percent(labels == truth))
                same.setdefault((name, inputs), []).append(_percent(labels == other))
        told(f"body {i}")
    return [Marks(*key, np.array(right[key]), np.array(same[key])) for key in right]


def seconds(published: Published, mesh: TriangleMesh) -> dict[str, dict[str, float]]:
    """Return the CPU seconds of each maker's stages on a mesh, once all is loaded and compiled."""
    found = {}
    for name, make in makers(published).items():
        for surface in (sk.geometry.creature(10_000), mesh):
            found[name] = make(*published.prepared(surface)).seconds
    return found


def _percent(good: Tensor) -> float:
    return 100 * float(good.double().mean())
