"""How well point maps agree with known correspondences.

Data flows `subjects` (meshes with landmarks) -> `protocols` (pairs) -> `pairs` (spectra, then a
point map by each of `methods`, marked by `measures`; side by side, remembered) -> `report`.
"""
