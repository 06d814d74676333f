"""Eigenvalues as functions that PyTorch can differentiate: of matrices, and of vertices.

It stands above operators and solvers: each of them may be called, and none knows of it. So to solve
imports no torch.
"""

from spectra_kit.eigen.differentiable.matrices import eigenvalues
from spectra_kit.eigen.differentiable.meshes import mesh_eigenvalues

__all__ = ["eigenvalues", "mesh_eigenvalues"]
