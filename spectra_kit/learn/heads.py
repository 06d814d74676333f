"""Heads that tell what a whole shape is from its embedding: those of scikit-learn.

Each is a frozen dataclass of its options, whose ``fit`` takes one row a shape.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.checked import checked
from spectra_kit._core.optional import optional
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_count, check_positive, real_array
from spectra_kit.errors import InvalidInputError


@runtime_checkable
class Head(Protocol):
    """What can learn to tell classes apart: a frozen dataclass of its options."""

    def fit(self, vectors: ArrayLike, labels: ArrayLike) -> Any:
        """Return a classifier of scikit-learn that knows rows (s, c) and their classes (s,)."""
        ...


@checked
@dataclass(frozen=True, kw_only=True)
class NearestNeighbour:
    """The class of the nearest example, or most of several, by the sum of all differences.

    Of the embeddings here, which are quantiles and logarithms, that sum is one of distances between
    distributions; it minds a few columns that are far off less than the sum of squares does.

    Parameters
    ----------
    neighbours : int, default 1
        How many vote.
    scaled : bool, default True
        Divide each column by its standard deviation over the examples.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.learn import NearestNeighbour
    >>> known = NearestNeighbour().fit(np.array([[0.0, 0.1], [1.0, 0.9]]), np.array([0, 1]))
    >>> known.predict([[0.2, 0.2]])
    array([0])
    """

    neighbours: int = 1
    scaled: bool = True

    def __post_init__(self) -> None:
        check_count("neighbours", self.neighbours, low=1)

    def fit(self, vectors: ArrayLike, labels: ArrayLike) -> Any:
        """Return it with its examples."""
        vectors, labels = _examples(vectors, labels)
        if len(vectors) < self.neighbours:
            raise InvalidInputError(
                "vectors", f"have {self.neighbours} rows or more, the neighbours", len(vectors)
            )
        classifier = _sklearn("neighbors").KNeighborsClassifier(self.neighbours, metric="manhattan")
        return _fitted(classifier, self.scaled, vectors, labels)


@checked
@dataclass(frozen=True, kw_only=True)
class LinearDiscriminant:
    """Linear discriminants of normal distributions with one covariance, shrunk (Ledoit, Wolf).

    With one example a class there is no covariance within classes: it decides as the nearest
    example does.
    """

    def fit(self, vectors: ArrayLike, labels: ArrayLike) -> Any:
        """Return it fitted."""
        vectors, labels = _examples(vectors, labels)
        if len(set(labels.tolist())) == len(labels):
            return NearestNeighbour().fit(vectors, labels)
        analysis = _sklearn("discriminant_analysis").LinearDiscriminantAnalysis
        return _fitted(analysis(solver="lsqr", shrinkage="auto"), True, vectors, labels)


@checked
@dataclass(frozen=True, kw_only=True)
class SupportVectors:
    """Support vectors with a Gaussian kernel, one class against another.

    Parameters
    ----------
    penalty : float, default 10
        Of examples on the wrong side.
    """

    penalty: float = 10.0

    def __post_init__(self) -> None:
        check_positive("penalty", self.penalty)

    def fit(self, vectors: ArrayLike, labels: ArrayLike) -> Any:
        """Return them fitted."""
        vectors, labels = _examples(vectors, labels)
        support = _sklearn("svm").SVC(C=self.penalty)
        return _fitted(support, True, vectors, labels)


def _examples(vectors: ArrayLike, labels: ArrayLike) -> tuple[Floats, Ints]:
    rows = real_array("vectors", vectors)
    if rows.ndim != 2 or not len(rows):
        raise InvalidInputError("vectors", "have shape (s, c), a row for each example", rows.shape)
    classes = np.asarray(labels)
    if classes.shape != (len(rows),) or classes.dtype.kind not in "iu":
        raise InvalidInputError("labels", f"be {len(rows)} integers", classes.shape)
    return rows, classes.astype(np.int64)


def _fitted(classifier: Any, scaled: bool, vectors: Floats, labels: Ints) -> Any:
    steps = [_sklearn("preprocessing").StandardScaler()] if scaled else []
    pipeline = _sklearn("pipeline").make_pipeline(*steps, classifier)
    with warnings.catch_warnings():
        # Few examples a class are what this is for.
        warnings.filterwarnings("ignore", "The number of unique classes is greater", UserWarning)
        return pipeline.fit(vectors, labels)


def _sklearn(module: str) -> Any:
    return optional(f"sklearn.{module}", extra="learn", needed_by="this head")
