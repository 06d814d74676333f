"""`StoreDataset`: the shapes of a store, for `torch.utils.data.DataLoader`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit._sparse.torch_device import check_float_dtype
from spectra_kit.datasets import Plan, ShapeRecord, SpectrumStore
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import Geometry, TriangleMesh
from spectra_kit.learn.tensors import ShapeTensors, csr_tensor
from spectra_kit.operators import laplacian, tangent_gradient


class _Entry(NamedTuple):
    """Where a shape's arrays are: no more, for workers get all of them."""

    name: str
    shape: str  #: Keys in the store.
    spectrum: str
    descriptors: Mapping[str, str]
    operators: Mapping[str, str]  #: Those that are kept; others are assembled.


@checked
@dataclass(frozen=True, eq=False)
class StoreDataset(Dataset[ShapeTensors]):
    """Shapes of a store as tensors, in the order of their names.

    Everything is read, but for operators that the plan did not keep (`Plan.operators`): these are
    assembled anew each time. Loads and is copied to workers quickly: it holds names alone.

    Parameters
    ----------
    store : SpectrumStore
        What `compute_all`, or `datasets.complete`, have filled.
    plan : Plan, optional
        Only what was computed by it; needed where shapes were computed by several.
    operators : tuple of {"stiffness", "gradient"}, default both
        Which there shall be: the weak Laplacian; frames, and slopes along their axes.
    oriented : bool, default True
        Let the normals of frames point outwards, as `tangent_gradient` does. Surfaces without an
        outer side are refused then; of clouds it takes as long as their modes.
    transform : callable, optional
        Takes the `ShapeTensors`, and returns what shall be in their place: `normalized`, or a
        function of one's own that adds labels. For workers that are started anew, one that can be
        pickled.
    dtype : torch.dtype, default torch.float32
        Of all that are no indices.

    Raises
    ------
    InvalidInputError
        When an item is asked for, if its modes are gone, or an operator refuses its geometry.
    InvalidFileError
        When an item is asked for, if a file of it is damaged. Modes are mapped into memory, without
        the checks that reading makes: ``store.verify()`` makes them all.

    Warns
    -----
    DamagedEntryWarning
        If a record is damaged: its shape is left out.

    Examples
    --------
    >>> import tempfile
    >>> import spectra_kit as sk
    >>> from torch.utils.data import DataLoader
    >>> folder = tempfile.mkdtemp()
    >>> store, plan = sk.datasets.SpectrumStore(f"{folder}/store"), sk.datasets.Plan(k=12)
    >>> for name in ("cat", "dog"):
    ...     sk.geometry.write(sk.geometry.creature(600), f"{folder}/{name}.off")
    ...     _ = sk.datasets.complete(store, name, f"{folder}/{name}.off", plan)
    >>> dataset = sk.learn.StoreDataset(store, transform=sk.learn.normalized)
    >>> dataset[0].points.norm(dim=1).max()
    tensor(1.)
    >>> for batch in DataLoader(dataset, batch_size=2, collate_fn=sk.learn.collate):
    ...     print(batch.names, batch.eigenvectors.shape)
    ('cat', 'dog') torch.Size([2, 600, 12])
    """

    store: SpectrumStore
    plan: Plan | None = None
    _: KW_ONLY
    operators: tuple[Literal["stiffness", "gradient"], ...] = ("stiffness", "gradient")
    oriented: bool = True
    transform: Callable[[ShapeTensors], Any] | None = None
    dtype: torch.dtype = torch.float32
    _entries: tuple[_Entry, ...] = field(init=False, repr=False)
    _assembly: Mapping[str, Any] = field(init=False, repr=False)  # options of the Laplacian

    def __post_init__(self) -> None:
        check_float_dtype(self.dtype)
        records = _of_one_plan([*self.store.records()], self.plan)
        entries = tuple(
            _Entry(
                *(one.name, one.shape, one.spectrum, one.descriptors),
                {
                    name: key
                    for name, key in one.operators.items()
                    if name != "gradient" or self.oriented  # which kept ones are
                },
            )
            for one in records
        )
        assembly = {name: records[0].facts[name] for name in ("operator", "boundary")}
        object.__setattr__(self, "_entries", entries)
        object.__setattr__(self, "_assembly", assembly)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the shapes, in their order."""
        return tuple(entry.name for entry in self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def __getitem__(self, index: int) -> Any:
        entry = self._entries[index]
        try:
            item = self._read(entry)
        except InvalidInputError as error:
            error.add_note(f"of the shape {entry.name!r}")
            raise
        return item if self.transform is None else self.transform(item)

    def _read(self, entry: _Entry) -> ShapeTensors:
        shape = self.store.shape(entry.shape)
        spectrum = self.store.load(entry.spectrum, mmap=True)
        if spectrum is None:
            raise InvalidInputError(
                "store",
                "hold the modes that its records name",
                "some are gone",
                advice="the run that computed them computes them again",
            )
        if spectrum.consistent_mass is not None:
            raise InvalidInputError(
                "store",
                "hold modes of lumped masses, one number for each point, as networks take them",
                "those of a consistent mass",
                advice="compute them with Plan(mass='lumped')",
            )
        eigenvalues, eigenvectors, mass = spectrum.to_torch(dtype=self.dtype)
        faces = shape.faces if isinstance(shape, TriangleMesh) else np.empty((0, 3))
        item = ShapeTensors(
            name=entry.name,
            points=self._tensor(shape.points),
            faces=torch.tensor(faces, dtype=torch.int64),
            mass=mass,
            eigenvalues=eigenvalues,
            eigenvectors=eigenvectors,
            descriptors={
                name: self._tensor(self.store.load_descriptor(key))
                for name, key in entry.descriptors.items()
            },
        )
        return self._with_operators(item, shape, entry.operators)

    def _with_operators(
        self, item: ShapeTensors, shape: Geometry, kept: Mapping[str, str]
    ) -> ShapeTensors:
        assembled: Mapping[str, Callable[[], Any]] = {
            "stiffness": lambda: laplacian(shape, **self._assembly).stiffness,
            "gradient": lambda: tangent_gradient(shape, oriented=self.oriented),
        }
        there: dict[str, Any] = {
            name: self.store.load_operator(kept[name]) if name in kept else assembled[name]()
            for name in self.operators
        }
        if "stiffness" in there:
            item = item._replace(stiffness=csr_tensor(there["stiffness"], self.dtype))
        if "gradient" in there:
            frames, x, y = there["gradient"]
            item = item._replace(
                frames=self._tensor(frames),
                gradient_x=csr_tensor(x, self.dtype),
                gradient_y=csr_tensor(y, self.dtype),
            )
        return item

    def _tensor(self, values: Floats) -> Tensor:
        return torch.tensor(values, dtype=self.dtype)


def _of_one_plan(records: list[ShapeRecord], plan: Plan | None) -> list[ShapeRecord]:
    """Return the records of a plan, or all, by their names; refuse none, and several plans."""
    if not records:
        raise InvalidInputError(
            "store", "hold shapes", "none", advice="fill it (datasets.compute_all)"
        )
    wanted = records[0].facts if plan is None else plan.facts
    chosen = [record for record in records if record.facts == wanted]
    if plan is None and len(chosen) < len(records):
        other = next(record.facts for record in records if record.facts != wanted)
        raise InvalidInputError(
            "plan",
            "tell which of several this store's shapes are computed by",
            f"none; they differ in {_difference(wanted, other)}",
        )
    if not chosen:
        raise InvalidInputError(
            "plan",
            "be one that shapes of this store are computed by",
            f"one that differs from theirs in {_difference(wanted, records[0].facts)}",
        )
    return sorted(chosen, key=lambda record: record.name)


def _difference(one: Mapping[str, object], other: Mapping[str, object]) -> str:
    names = [name for name in one if one[name] != other.get(name)]
    return ", ".join(f"{name} ({one[name]}, {other.get(name)})" for name in names)
