"""Eigensolvers side by side: seconds, memory and errors of every backend and of other packages.

Data flows `methods` (backends, and the `peers` wrapped as backends) -> `studies` (problems: an
operator and its exact modes; then every method on every problem) -> `report`.
"""
