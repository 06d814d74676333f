"""Eigensolvers side by side: seconds, memory and errors of every backend and of other packages.

Data flows `methods` (backends) -> `solves` (problems: an operator and its exact modes; then every
method on every problem) -> `summary` -> the tables of `command`.
"""
