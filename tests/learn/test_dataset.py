"""Shapes of a store as tensors: what they were, whoever reads them, alone and side by side."""

import os
import pickle
import shutil
import warnings
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import creature, refused
from torch.utils.data import DataLoader

import spectra_kit as sk
from spectra_kit.datasets import Plan, SpectrumStore, complete
from spectra_kit.errors import DoubtfulMatchWarning, InvalidFileError, InvalidInputError
from spectra_kit.geometry import TriangleMesh, rectangle, torus, write
from spectra_kit.learn import (
    Batch,
    DiffusionNet,
    Hierarchical,
    PointMLP,
    PointNet,
    StoreDataset,
    collate,
    normalized,
)
from spectra_kit.operators import tangent_gradient

SHAPES = {
    "animal": creature(520),
    "cloud": creature(510, seed=1).as_cloud(),
    "ring": torus(n=400).geometry,
    "sheet": rectangle(n=300).geometry,
}
PLAN = Plan(k=16, descriptors=("hks", "wks", "gps", "dna"), operators=("stiffness", "gradient"))


def fill(folder, shapes, plan):
    """A store of shapes, read from files."""
    store = SpectrumStore(folder / "store")
    for name, shape in shapes.items():
        path = folder / f"{name}.ply"
        write(shape, path)
        complete(store, name, path, plan)
    return store


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return fill(tmp_path_factory.mktemp("shapes"), SHAPES, PLAN)


@pytest.fixture(scope="module")
def exact(store):
    return StoreDataset(store, PLAN, dtype=torch.float64)


@pytest.fixture(scope="module")
def batch(exact):
    return collate([*exact])


def dense(part):
    return part.to_dense() if isinstance(part, torch.Tensor) else part


def assert_same(one, other):
    for name, part, twin in zip(one._fields, one, other, strict=True):
        if isinstance(part, dict):
            assert part.keys() == twin.keys()
            assert all(torch.equal(part[key], twin[key]) for key in part), name
        elif isinstance(part, torch.Tensor):
            assert part.layout == twin.layout
            assert torch.equal(dense(part), dense(twin)), name
        else:
            assert part == twin, name


# --- one shape ---


def test_items_are_what_the_store_holds_in_the_order_of_names(exact, store):
    assert exact.names == tuple(SHAPES)
    assert len(exact) == 4
    for item, (name, shape) in zip(exact, SHAPES.items(), strict=True):
        record = store.record(name, PLAN)
        spectrum, laplacian = store.load(record.spectrum), PLAN.laplacian(store.shape(record.shape))
        assert item.name == name
        np.testing.assert_allclose(item.points, shape.points, atol=1e-6)  # as files have them
        faces = shape.faces if isinstance(shape, TriangleMesh) else np.empty((0, 3))
        np.testing.assert_array_equal(item.faces, faces)
        assert item.faces.dtype == torch.int64
        np.testing.assert_array_equal(item.mass, laplacian.mass)
        np.testing.assert_array_equal(dense(item.stiffness), laplacian.stiffness.toarray())
        np.testing.assert_array_equal(item.eigenvalues, spectrum.eigenvalues)
        np.testing.assert_array_equal(item.eigenvectors, spectrum.eigenvectors)
        assert item.labels is None


def test_tensors_obey_the_laws_of_their_operators(exact):
    for item in exact:
        U, one = item.eigenvectors, torch.ones(len(item.points), dtype=torch.float64)
        identity = torch.eye(16, dtype=torch.float64)
        torch.testing.assert_close(U.T @ (item.mass[:, None] * U), identity, atol=1e-8, rtol=0)
        torch.testing.assert_close(
            U.T @ (item.stiffness @ U), torch.diag(item.eigenvalues), atol=1e-6, rtol=1e-6
        )
        for matrix in (item.gradient_x, item.gradient_y):
            assert (matrix @ one).abs().max() < 1e-8
        torch.testing.assert_close(torch.linalg.det(item.frames), one, atol=1e-12, rtol=0)


def test_linear_functions_have_exact_gradients(exact):
    sheet = exact[exact.names.index("sheet")]
    slope = torch.tensor([3.0, -2.0, 0.0], dtype=torch.float64)
    values = (sheet.points @ slope)[:, None]
    along, across = sheet.gradient_x @ values, sheet.gradient_y @ values
    found = along * sheet.frames[:, 0] + across * sheet.frames[:, 1]
    torch.testing.assert_close(found, slope.expand_as(found), atol=1e-8, rtol=0)


def test_float32_is_the_default_and_no_operator_costs_nothing(store, exact):
    item = StoreDataset(store, operators=())[0]
    tensors = [part for part in (*item, *item.descriptors.values()) if torch.is_tensor(part)]
    assert {t.dtype for t in tensors} == {torch.float32, torch.int64}
    assert item.stiffness is item.frames is item.gradient_x is item.gradient_y is None
    np.testing.assert_array_equal(item.eigenvectors, exact[0].eigenvectors.float())


def test_normals_point_outwards_unless_nobody_asks(store, exact):
    animal = exact[0]
    free = StoreDataset(store, operators=("gradient",), oriented=False, dtype=torch.float64)[0]
    a, b, c = (animal.points[animal.faces[:, i]] for i in range(3))
    volume = torch.linalg.cross(a, b).mul(c).sum() / 6
    assert volume > 0  # its faces run counter-clockwise
    normals = torch.zeros_like(animal.points)
    for i in range(3):
        normals.index_add_(0, animal.faces[:, i], torch.linalg.cross(b - a, c - a))
    assert (normals.mul(animal.frames[:, 2]).sum(1) > 0).all()
    assert (normals.mul(free.frames[:, 2]).sum(1) < 0).any()


@pytest.mark.parametrize("by", ["radius", "area"])
def test_a_normalized_shape_is_that_of_the_smaller_surface(tmp_path, exact, by):
    animal = exact[0]
    size = {"radius": (animal.points - animal.points.mean(0)).norm(dim=1).max(),
            "area": animal.mass.sum().sqrt()}[by]  # fmt: skip
    item = normalized(animal, by=by)
    points = ((animal.points - animal.points.mean(0)) / size).numpy()
    write(TriangleMesh(points, SHAPES["animal"].faces), tmp_path / "small.npz")
    small = SpectrumStore(tmp_path / "store")
    complete(small, "animal", tmp_path / "small.npz", PLAN)
    other = StoreDataset(small, dtype=torch.float64)[0]
    for name in ("points", "mass", "eigenvalues"):
        torch.testing.assert_close(
            getattr(item, name), getattr(other, name), rtol=1e-6, atol=1e-9, msg=name
        )
    torch.testing.assert_close(item.eigenvectors.abs(), other.eigenvectors.abs(), rtol=0, atol=1e-6)
    torch.testing.assert_close(dense(item.stiffness), dense(other.stiffness), rtol=0, atol=1e-8)
    for name in ("gradient_x", "gradient_y"):
        torch.testing.assert_close(
            dense(getattr(item, name)).abs(), dense(getattr(other, name)).abs(), rtol=0, atol=1e-6
        )
    for name, values in item.descriptors.items():
        torch.testing.assert_close(
            values.abs(), other.descriptors[name].abs(), rtol=1e-5, atol=1e-6, msg=name
        )


# --- side by side ---


def test_a_batch_holds_each_shape_and_padding_counts_for_nothing(exact, batch):
    assert batch.points.shape == (4, 520, 3)
    for i, item in enumerate(exact):
        own, faces = batch.mask[i], batch.face_mask[i]
        assert (own.sum(), faces.sum()) == (len(item.points), len(item.faces))
        for name in ("points", "mass", "eigenvectors", "frames"):
            padded = getattr(batch, name)[i]
            assert torch.equal(padded[own], getattr(item, name))
            assert not padded[~own].any()
        assert torch.equal(batch.faces[i][faces], item.faces)
        assert torch.equal(batch.descriptors["dna"][i], item.descriptors["dna"])
        assert torch.equal(batch.descriptors["hks"][i][own], item.descriptors["hks"])


def test_what_is_computed_of_a_batch_is_computed_of_each_shape(exact, batch):
    b, n = batch.mask.shape
    values = torch.from_numpy(np.random.default_rng(0).standard_normal((b, n, 3)))
    U = batch.eigenvectors
    projected = U @ (U.mT @ (batch.mass[..., None] * values))
    flat = values.flatten(0, 1)
    products = {
        name: (getattr(batch, name) @ flat).unflatten(0, (b, n))
        for name in ("stiffness", "gradient_x", "gradient_y")
    }
    for i, item in enumerate(exact):
        own = batch.mask[i]
        alone = values[i][own]
        V = item.eigenvectors
        expected = V @ (V.T @ (item.mass[:, None] * alone))
        torch.testing.assert_close(projected[i][own], expected)
        for name, product in products.items():
            torch.testing.assert_close(product[i][own], getattr(item, name) @ alone)
            assert not product[i][~own].any()


def test_sparse_operators_let_gradients_through(batch):
    values = torch.rand(batch.mask.numel(), 2, dtype=torch.float64, requires_grad=True)
    torch.autograd.backward((batch.gradient_x @ values).square().sum())
    dense_x = batch.gradient_x.to_dense()
    torch.testing.assert_close(values.grad, 2 * dense_x.T @ (dense_x @ values.detach()))


def test_the_seven_of_a_batch_are_those_of_each_shape(exact, batch):
    seven = batch.diffusion_net()
    for i, item in enumerate(exact):
        own = batch.mask[i]
        for name, part in item.diffusion_net()._asdict().items():
            together = dense(getattr(seven, name))[i]
            if name in ("L", "gradX", "gradY"):
                assert part.layout == torch.sparse_coo
                assert part.is_coalesced()
                together = together[own][:, own]
            elif name != "evals":
                together = together[own]
            assert torch.equal(together, dense(part)), name


def test_the_seven_are_those_of_interop(store):
    item, shape = StoreDataset(store)[0], store.shape(store.record("animal", PLAN).shape)
    laplacian = PLAN.laplacian(shape)
    spectrum = store.load(store.record("animal", PLAN).spectrum)
    gradient = tangent_gradient(shape, oriented=True)
    assert_same(item.diffusion_net(), sk.interop.to_diffusion_net(spectrum, laplacian, gradient))


def with_labels(of, item):
    counts = {"shape": [], "points": [len(item.points)], "faces": [len(item.faces)]}
    return item._replace(labels=torch.ones(counts[of], dtype=torch.int64))


def test_labels_of_a_transform_are_padded_by_what_losses_leave_out(store):
    for of, masked in (("points", "mask"), ("faces", "face_mask")):
        batch = collate([*StoreDataset(store, transform=partial(with_labels, of))])
        assert torch.equal(batch.labels == 1, getattr(batch, masked))
        assert (batch.labels[batch.labels != 1] == -1).all()
    batch = collate([*StoreDataset(store, transform=partial(with_labels, "shape"))])
    assert batch.labels.tolist() == [1, 1, 1, 1]


def test_all_of_it_moves(exact, batch):
    for thing in (exact[0], batch):
        assert_same(thing.to("cpu"), thing)
        there = thing.to("meta")
        assert there.gradient_x.device.type == there.descriptors["hks"].device.type == "meta"


# --- workers ---


def test_workers_read_the_same_items(store):
    dataset = StoreDataset(store, transform=normalized)
    for options in ({"batch_size": None}, {"batch_size": 2, "collate_fn": collate}):
        alone, several = (
            [*DataLoader(dataset, num_workers=workers, **options)] for workers in (0, 2)
        )
        assert len(alone) == len(several)
        for one, other in zip(alone, several, strict=True):
            assert_same(one, other)


def test_a_copy_for_a_worker_reads_the_same(store):
    dataset = StoreDataset(store, transform=normalized)
    assert_same(pickle.loads(pickle.dumps(dataset))[1], dataset[1])


# --- what is refused ---


def test_the_plan_is_asked_for_where_there_are_several(tmp_path):
    store = fill(tmp_path, {"ring": SHAPES["ring"]}, Plan(k=8))
    fill(tmp_path, {"ring": SHAPES["ring"]}, Plan(k=9))
    expected = "tell which of several this store's shapes are computed by"
    with pytest.raises(InvalidInputError, match=rf"`plan` must {expected}.* k \((8, 9|9, 8)\)"):
        StoreDataset(store)
    assert [len(StoreDataset(store, Plan(k=k))[0].eigenvalues) for k in (8, 9)] == [8, 9]
    with pytest.raises(InvalidInputError, match=r"be one that shapes .* differs .* k \(7, [89]\)"):
        StoreDataset(store, Plan(k=7))


def test_what_cannot_be_read_is_told(tmp_path):
    refused("store", "hold shapes", StoreDataset, SpectrumStore(tmp_path / "empty"))
    store = fill(tmp_path, {"ring": SHAPES["ring"]}, Plan(k=8, descriptors=("dna",)))
    dataset = StoreDataset(store)
    paths = {entry.kind: entry.path for entry in store.entries()}
    content = paths["spectra"].read_bytes()
    paths["spectra"].unlink()
    refused("store", "hold the modes that its records name", dataset.__getitem__, 0)
    paths["spectra"].write_bytes(content)
    paths["shapes"].write_bytes(paths["shapes"].read_bytes()[:-100])
    with pytest.raises(InvalidFileError) as caught:
        dataset[0]
    assert caught.value.__notes__ == ["of the shape 'ring'"]
    complete(store, "ring", tmp_path / "ring.ply", Plan(k=8, descriptors=("dna",)))
    paths["descriptors"].unlink()
    with pytest.raises(InvalidFileError, match="there is no such file"):
        dataset[0]
    with pytest.raises(IndexError):
        dataset[1]


def test_operators_that_are_kept_are_those_that_are_assembled(store, tmp_path):
    bare = fill(tmp_path, SHAPES, replace(PLAN, operators=()))
    for one, other in zip(StoreDataset(store), StoreDataset(bare), strict=True):
        assert_same(one, other)
    own = SpectrumStore(shutil.copytree(store.path, tmp_path / "own"))
    files = {entry.path for entry in own.entries("operators")}
    assert len(files) == 2 * len(SHAPES)
    sides = (StoreDataset(kept, oriented=False)[0] for kept in (own, bare))
    assert_same(*sides)  # assembled, as those that are kept have outer sides
    for path in files:
        path.unlink()
    with pytest.raises(InvalidFileError, match="there is no such file"):
        StoreDataset(own)[0]
    assert StoreDataset(own, operators=())[0].stiffness is None


def test_a_face_of_the_other_winding_is_turned_where_sides_matter(tmp_path):
    ring = SHAPES["ring"]
    faces = ring.faces.copy()
    faces[0] = faces[0, ::-1]
    store = fill(tmp_path, {"ring": TriangleMesh(ring.points, faces)}, Plan(k=8))
    with pytest.warns(DoubtfulMatchWarning, match="1 face wound against the others"):
        outer = StoreDataset(store)[0]
    assert outer.frames.shape == (ring.n, 3, 3)
    assert StoreDataset(store, oriented=False)[0].frames.shape == (ring.n, 3, 3)


def test_items_that_do_not_fit_together_are_refused(exact):
    ring, sheet = exact[2], exact[3]
    few = sheet._replace(eigenvalues=sheet.eigenvalues[:9], eigenvectors=sheet.eigenvectors[:, :9])
    for items, expected in (
        ([], "hold at least one shape"),
        ([ring, few], "have as many modes each"),
        ([ring, sheet._replace(descriptors={})], "have the same `descriptors`"),
        (
            [ring, ring._replace(descriptors={**ring.descriptors, "dna": ring.mass[:3]})],
            "have as many numbers each in the descriptor 'dna'",
        ),
        ([ring, sheet._replace(stiffness=None)], "all have `stiffness`, or none"),
        ([ring._replace(labels=torch.tensor(1)), sheet], "all have `labels`, or none"),
    ):
        refused("items", expected, collate, items)
    own = ring._replace(descriptors={"mine": ring.mass})
    refused("item", "have descriptors among hks, wks, gps, dna", normalized, own)


def test_diffusion_net_needs_both_operators(store):
    for operators in ((), ("stiffness",), ("gradient",)):
        item = StoreDataset(store, operators=operators)[0]
        for thing in (item, collate([item, item])):
            refused("operators", "hold 'stiffness' and 'gradient'", thing.diffusion_net)


# --- DiffusionNet itself ---

PEER = Path(os.environ.get("SPECTRA_KIT_DATA", ".")).parent / "peers" / "diffusion_net"


@pytest.fixture(scope="module")
def published():
    if not (PEER / "diffusion_net").is_dir():
        pytest.skip(f"no {PEER}")
    from studies.learning.diffusion_net import Published

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # theirs
        return Published.from_folder(PEER)


@pytest.mark.data
def test_our_seven_stand_for_those_of_diffusion_net(published):
    points, faces = published.prepared(creature(700))
    theirs = published.operators(points, faces).tensors
    mesh = TriangleMesh(points.double().numpy(), faces.numpy())
    areas = np.bincount(mesh.faces.ravel(), np.repeat(mesh.face_areas / 3, 3))  # their mass
    laplacian = sk.Laplacian(sk.cotan_laplacian(mesh).stiffness, areas, mesh.points)
    ours = sk.interop.to_diffusion_net(
        sk.eigensolve(laplacian, 128), laplacian, tangent_gradient(mesh, oriented=True)
    )
    for one, other in zip(ours, theirs, strict=True):
        assert (one.shape, one.dtype, one.layout) == (other.shape, other.dtype, other.layout)
    torch.testing.assert_close(ours.mass, theirs[1], rtol=1e-4, atol=1e-8)
    torch.testing.assert_close(dense(ours.L), dense(theirs[2]), rtol=1e-3, atol=1e-3)
    torch.testing.assert_close(ours.evals, theirs[3], rtol=1e-3, atol=1e-3)
    # Normals are on the same side, and gradients of a smooth function nearly the same vectors.
    assert (ours.frames[:, 2].mul(theirs[0][:, 2]).sum(1) > 0).float().mean() > 0.99
    values = torch.sin(2 * points[:, :1])

    def in_space(seven):
        frames, grad_x, grad_y = seven[0], seven[5], seven[6]
        return (grad_x @ values) * frames[:, 0] + (grad_y @ values) * frames[:, 1]

    one, other = in_space(ours), in_space(theirs)
    assert (one - other).norm() < 0.2 * other.norm()


@pytest.mark.data
def test_its_layers_answer_a_batch_as_each_shape(published, store):
    dataset = StoreDataset(store, transform=normalized)
    network = published.networks["coordinates"]
    items = [item for item in dataset if len(item.faces)]
    batch = collate(items)

    def answer(points, seven, faces):
        options = {"L": seven.L, "evals": seven.evals, "evecs": seven.evecs}
        return network(
            points, seven.mass, gradX=seven.gradX, gradY=seven.gradY, faces=faces, **options
        )

    with torch.no_grad():
        together = answer(batch.points, batch.diffusion_net(), batch.faces)
        for i, item in enumerate(items):
            alone = answer(item.points, item.diffusion_net(), item.faces)
            torch.testing.assert_close(together[i][batch.face_mask[i]], alone, rtol=1e-3, atol=1e-3)


@torch.no_grad()
@pytest.mark.parametrize(
    "network",
    [PointMLP(), PointNet(), DiffusionNet(), Hierarchical(backbone="pointnet++", width=16)],
    ids=str,
)
def test_networks_take_a_batch_of_a_store_as_it_is(store, network) -> None:
    dataset = StoreDataset(store, PLAN)
    shapes = collate([*dataset])
    channels = 3 + sum(part.shape[-1] for part in shapes.descriptors.values() if part.ndim == 3)
    torch.manual_seed(0)
    module = network.build(channels, 8).eval()
    answers = module(shapes)
    assert answers.shape == (*shapes.mask.shape, 8)
    fields = (shapes.mass, shapes.eigenvalues, shapes.eigenvectors, shapes.slopes)
    assert torch.equal(module(Batch(shapes.features, shapes.points, *fields)), answers)
    assert torch.equal(module(shapes.to("cpu")), answers)
    for item, answer in zip(dataset, answers, strict=True):
        n = len(item.points)
        torch.testing.assert_close(module(collate([item]))[0], answer[:n], atol=1e-4, rtol=1e-3)
    refused(
        "features",
        f"have the {channels + 1} channels that the network was built for, got {channels};",
        network.build(channels + 1, 8),
        shapes,
    )


def test_a_network_tells_what_a_batch_lacks(store) -> None:
    shapes = collate([*StoreDataset(store, PLAN, operators=())])
    assert shapes.slopes is None
    module = DiffusionNet().build(shapes.features.shape[-1], 2)
    refused("batch", "hold modes and 'gradient', for DiffusionNet", module, shapes)


def test_modes_of_a_consistent_mass_are_no_items(tmp_path):
    """Networks weigh points by one number each, by which these modes are not orthonormal."""
    store, plan = SpectrumStore(tmp_path / "store"), Plan(k=8, mass="consistent")
    write(creature(500), tmp_path / "a.off")
    complete(store, "a", tmp_path / "a.off", plan)
    refused("store", "hold modes of lumped masses", lambda: StoreDataset(store)[0])
