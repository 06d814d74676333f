"""Eigenvalues as functions that PyTorch can differentiate: of matrices, and of vertices.

It stands above operators and solvers: each of them may be called, and none knows of it. So to solve
imports no torch.

>>> import torch
>>> from spectra_kit.eigen.differentiable import mesh_eigenvalues
>>> from spectra_kit.geometry import sphere
>>> ball = sphere(subdivisions=2).geometry
>>> points = torch.tensor(ball.points, requires_grad=True)
>>> values = mesh_eigenvalues(points, ball.faces, 4)
>>> values.sum().backward()

Twice the size has a quarter of the eigenvalues, so the gradient along the points is -2 times them:

>>> bool(torch.isclose((points.grad * points).sum(), -2 * values.sum()))
True
"""

from spectra_kit.eigen.differentiable.matrices import eigenvalues
from spectra_kit.eigen.differentiable.meshes import mesh_eigenvalues

__all__ = ["eigenvalues", "mesh_eigenvalues"]
