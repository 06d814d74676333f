"""`Neo`: eigenpairs from one forward pass of the neural operator and a small dense problem."""

from __future__ import annotations
