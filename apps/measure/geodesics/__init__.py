"""Distance solvers side by side: iterations, seconds from the arrays on, errors, agreement.

Data flows `contenders` (ours and other packages, under one interface) -> `studies` (modes and exact
distances, then errors, times, and rates on the sphere) -> `report`.
"""
