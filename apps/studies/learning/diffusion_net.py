"""Run DiffusionNet's own layers and published weights on our operators, and on its own.

    python apps/studies/run.py diffusion-net OUT --peer FOLDER
    python apps/studies/run.py diffusion-net OUT --peer FOLDER --data DATA/tasks --vertices 100000

FOLDER holds the authors' package diffusion_net/ and pretrained/human_seg_hks_4x128.pth and
human_seg_xyz_4x128.pth; it is imported as it is, and needs scikit-learn beside what we need.
The weights tell the parts of human bodies; they are asked about the faces of the test bodies of
human_seg_meshcnn.npz, which are simplified to 1,500 faces, with operators of four makers: faces
labelled right, in percent, on average and on the worst body, and those labelled as with their own
operators, right or wrong. Then all seven tensors of one animal are made by each, with 128 modes,
and timed: CPU seconds.
"""

from __future__ import annotations

import argparse
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
from tqdm import tqdm

import spectra_kit as sk
from spectra_kit.errors import DoubtfulSpectrumWarning, InvalidInputError
from spectra_kit.geometry import TriangleMesh, creature
from spectra_kit.operators import tangent_gradient
from studies.learning.labelled import SEGMENTED, LabelledSet, labelled_set
from studies.machine import describe_machine
from studies.report import Table, write_report
from studies.store import Record

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


def mark(published: Published, shapes: LabelledSet, chosen: Sequence[int]) -> list[Record]:
    """Label the faces of some bodies by the operators of each maker.

    The shares that are right, and those as with their own operators, right or wrong, are in percent
    of the faces of each body.
    """
    marks: dict[tuple[str, str], Record] = {
        (name, inputs): {"maker": name, "inputs": inputs, "right": [], "as_theirs": []}
        for name in makers(published)
        for inputs in INPUTS
    }
    for i in tqdm(chosen, "bodies", disable=None):
        points, faces = published.prepared(shapes.meshes[i])
        truth = torch.tensor(shapes.face_labels[i])
        theirs: list[Tensor] = []
        for name, make in makers(published).items():
            found = published.labels(points, faces, make(points, faces).tensors)
            theirs = theirs or found
            for inputs, labels, other in zip(INPUTS, found, theirs, strict=True):
                marks[name, inputs]["right"].append(_percent(labels == truth))
                marks[name, inputs]["as_theirs"].append(_percent(labels == other))
    return list(marks.values())


def seconds(published: Published, mesh: TriangleMesh) -> dict[str, dict[str, float]]:
    """Return the CPU seconds of each maker's stages on a mesh, once all is loaded and compiled."""
    found = {}
    for name, make in makers(published).items():
        for surface in (creature(min(10_000, mesh.n)), mesh):
            found[name] = make(*published.prepared(surface)).seconds
    return found


def _percent(good: Tensor) -> float:
    return 100 * float(good.double().mean())


# --- command ---


def options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--peer", type=Path, required=True, help="folder of the authors' package and weights")
    add("--data", type=Path, help="folder of the sets (default: $SPECTRA_KIT_DATA/tasks)")
    add("--bodies", type=int, help="only so many test bodies")
    add("--vertices", type=int, default=100_000, help="of the mesh that is timed (%(default)s)")


def measure(args: argparse.Namespace) -> None:
    published = Published.from_folder(args.peer)
    bodies = labelled_set("human", args.data, SEGMENTED)
    chosen = bodies.test[: args.bodies].tolist()
    marks = mark(published, bodies, chosen)
    mesh = creature(args.vertices)
    times = seconds(published, mesh)
    accuracy = {"operators": "", "inputs": "", "mean": ".2f", "difference": "+.2f"}
    accuracy |= {"worst": ".2f", "body": "d", "same labels": ".2f"}
    stages = dict.fromkeys(stage for made in times.values() for stage in made)
    write_report(
        args.out,
        "diffusion-net",
        [],
        [
            Table("Faces labelled right", _accuracy(marks, chosen), accuracy),
            Table(
                "Seconds",
                [
                    {"operators": name, "sum": sum(made.values()), **made}
                    for name, made in times.items()
                ],
                {"operators": "", "sum": ".1f", **dict.fromkeys(stages, ".2f")},
            ),
        ],
        describe_machine(threads=torch.get_num_threads()),
        marks=marks,
        bodies=chosen,
        seconds=times,
        vertices=mesh.n,
    )


def _accuracy(marks: Sequence[Record], chosen: Sequence[int]) -> list[Record]:
    theirs = {one["inputs"]: np.mean(one["right"]) for one in marks[: len(INPUTS)]}
    return [
        {
            **{"operators": one["maker"], "inputs": one["inputs"], "mean": np.mean(one["right"])},
            "difference": np.mean(one["right"]) - theirs[one["inputs"]],
            **{"worst": min(one["right"]), "body": chosen[int(np.argmin(one["right"]))]},
            "same labels": np.mean(one["as_theirs"]),
        }
        for one in marks
    ]
