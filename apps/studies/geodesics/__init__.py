"""Geodesic distances side by side: ours, potpourri3d's and libigl's.

Data flows `contenders` -> `distances` (modes, exact distances, errors and seconds) -> the tables of
`command`.
"""
