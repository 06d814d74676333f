"""Labels for shapes and for their points, learned from examples.

A `Recipe` says how shapes become numbers: by which embeddings, of which spectrum. A head of
scikit-learn (`NearestNeighbour`, `LinearDiscriminant`, `SupportVectors`) learns to tell whole
shapes apart, a network (`PointMLP`, `PointNet`, `DiffusionNet`, `Hierarchical`) these or their
points. What comes out, a `Classifier` or a `Segmenter`, labels any mesh or cloud and can be saved.

For networks of one's own, a `StoreDataset` gives the shapes of a store as tensors, and `collate`
puts them side by side.

>>> import spectra_kit as sk
>>> from spectra_kit import learn
>>> shapes = [sk.geometry.sphere(subdivisions=3).geometry, sk.geometry.torus(n=400).geometry]
>>> recipe = learn.Recipe(embeddings=(sk.features.ShapeDNA(count=8),), k=16)
>>> known = learn.train_classifier(
...     shapes, [0, 1], recipe=recipe, method=learn.NearestNeighbour(), names=["ball", "ring"]
... )
>>> known.classify(sk.geometry.torus(n=600).geometry).name
'ring'
"""

from spectra_kit.learn.dataset import StoreDataset
from spectra_kit.learn.examples import Recipe
from spectra_kit.learn.files import load_labeller, save_labeller
from spectra_kit.learn.fitting import Training
from spectra_kit.learn.heads import Head, LinearDiscriminant, NearestNeighbour, SupportVectors
from spectra_kit.learn.index import Neighbour, ShapeIndex, index_folder
from spectra_kit.learn.labellers import (
    Classification,
    Classifier,
    Segmentation,
    Segmenter,
    train_classifier,
    train_segmenter,
)
from spectra_kit.learn.networks import (
    Batch,
    DiffusionNet,
    Hierarchical,
    Network,
    PointMLP,
    PointNet,
)
from spectra_kit.learn.tensors import ShapeBatch, ShapeTensors, collate, normalized

__all__ = [
    "Batch",
    "Classification",
    "Classifier",
    "DiffusionNet",
    "Head",
    "Hierarchical",
    "LinearDiscriminant",
    "NearestNeighbour",
    "Neighbour",
    "Network",
    "PointMLP",
    "PointNet",
    "Recipe",
    "Segmentation",
    "Segmenter",
    "ShapeBatch",
    "ShapeIndex",
    "ShapeTensors",
    "StoreDataset",
    "SupportVectors",
    "Training",
    "collate",
    "index_folder",
    "load_labeller",
    "normalized",
    "save_labeller",
    "train_classifier",
    "train_segmenter",
]
