"""How well point maps agree with known correspondences.

Data flows `subjects` (meshes with landmarks) -> `sets` (which pairs of them) -> `pairs` (spectra,
then a point map by each of `methods`, marked by `measures`; side by side, remembered) -> the tables
of `command`. `dense`, `collection` and `parts` are studies of their own.
"""
