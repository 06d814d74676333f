"""Marching cubes in NumPy: surfaces from fields, also where no compiled library is installed."""

from __future__ import annotations

import numpy as np

from spectra_kit._types import Floats, Ints

# Corners of a cell as (x, y, z), and its edges as pairs of corners.
_CORNERS = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]
)
_EDGES = np.array(
    [[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]]
)
# Lorensen and Cline's table: for each set of inside corners (bit i is corner i) the edges that
# the triangles' corners lie on, three hexadecimal digits per triangle, and a full stop. Ambiguous
# faces are cut the same way from both sides, so the surface has no gaps.
_DIGITS = """
. 038. 091. 138918. 1a2. 23828a0181a8. 9a2092. 23828aa89. 32b. 02b80b. 30939b1292b9. 12b1b99b8.
31ab3a. 01a0a88ab. 30939bb9a. 9a8ab8. 487. 403743. 491417081871. 491417713. 1a2874.
37a3a274a1a040a. 9a7974a27870207. 29a279237749. b74b42834324. b74b42240. 9749b791b2b1083.
4b79b492b912. 3143481a474bab4. 1ab1b414074b. 0834979b79ab. 4b749b9ab. 945. 845853905035. 045105.
845853351. 5a2524192942. 3a235a385458019. 5a2524420. 25a352345384. 9452b3. 0250592b5458b85.
04b0b345b2b151b. 2512852b8458. ab4a45b34941314. 01984a8aba45. 5045b05abb30. 5845a8ab8. 987597.
903935537. 087071175. 135375. 982921872a25752. 9015a35373a2. 820852875a25. 25a235375.
75272b592328982. 9759279022b7. 08312717572b. b12b71751. a75ab7981831. 5b75ab190. b5ab75830. b5a75b.
a56. 03856a. a10a06950560. 13616a386569896. 156216. 158180568382628. 956960062. 589528562382.
6b36352a3a53. b85b56805a52025. 0b306b09656912a. 12a95b9b8b56. 6b3635531. 0b805b01556b.
36b063056095. 6956b9b89. 76a7a854a48a. 40a4a503a6a737a. 16a176107870954. 954a16176137.
628687218485158. 362376150540. 954086062687. 723762549. 348354325a52b76. 76b54a42a402.
6b712a083495. 954a1276b. b76834354315. 50154076b. 083495b76. 49576b. a946a4. 4634386a3039a93.
a10a06604. 8138618466a1. 194142246. 190234246438. 042462. 823842462. a93a32943b36463. 4b846b0292a9.
12a30b06b046. 6846b82a1. 946963931b36. 86b846901. 36b306046. 684b86. 76a7a88a9. 03707a0a96a7.
a7617a187108. a76a17137. 162186198876. 276237019. 708760620. 723627. 6b72a3a83a98. 2902a96b7.
12a3086b7. a126b7. 819831b76. 019b76. 308b76. 76b. 7b6. 7807063b0b60. 091b67. 896867916b63136.
b21b17a61671. 1801781a767a23b. 20727b09767a9a7. 23ba68a89867. 732672. 780706602. 269291679093739.
126168189867. a67a71173. a671a7178180. 0730a709a67a. 7a678a89a. 648b68. 3b6360064. 8b1810b61914641.
964936913b63. 64161a48121b8b1. 3b201606461a. 08228b49a4a6. a49a64b23. 832824426. 024426.
308129249264. 149124264. 83181686461a. a01a60640. 4a649a083. a4964a. 65969b4797b9. 059065036b63847.
51b5b610b7b404b. 8473b53515b6. 9219b294b7b45a6. 01947823b5a6. 5a647242027b. 3b2784a65.
739794329596269. 847905065026. 125526304347. 612651478. a65197173794. 1905a6847. 43047365a. 5a6478.
65969bb98. 3b6036065059. 08b0b50515b6. 63b653513. 5a61929b298b. 01923b5a6. b08b20a65. 23ba65.
598582526328. 965906026. 165126308. 165261. 1831985a6. 9015a6. 0835a6. a65. ba57b5.
ba0b03a50807570. 5705097b010aba0. 958857a13a3b. b21b17715. 23b018178157. 95797292027b. 7957893b2.
2a5253357. 802825857a52. a12950530573. 978957a12. 153357. 078017157. 930953573. 978579. 54858aa8b.
54050b5bab03. 4950818a18ba. a3ba13954. 21525828b485. 05401523b. 0b208b495. 95423b. 2a5325354348.
52a542402. 30812a495. 12a954. 854835315. 054150. 954083. 954. 47b4b99ba. 47890b9bab03.
1ba14b1047b4. 3a13ba784. 47b94b9b2921. 90184723b. b47b24204. 8473b2. 2a9297273794. 92a902847.
34730412a. 12a847. 419471731. 019847. 430734. 478. 98aa8b. 3903b9ba9. 0a108a8ba. 3a1ba3. 1b219b98b.
19023b. 0b28b0. 3b2. 2832a8a98. 92a029. 08312a. 12a. 183981. 019. 083. .
"""
_TABLE = _DIGITS.split()
_COUNTS = np.array([len(row) // 3 for row in _TABLE])
_TRIANGLES = np.array([[int(e, 16) for e in row[:-1].ljust(15, "0")] for row in _TABLE])


def marching_cubes(values: Floats, nodes: Floats) -> tuple[Floats, Ints]:
    """Return the zero set of a function on a grid as triangles.

    Parameters
    ----------
    values : ndarray of shape (nz, ny, nx)
        Negative inside; zero counts as inside.
    nodes : ndarray of shape (nz, ny, nx, 3)
        Where the values are, in length.

    Returns
    -------
    points : ndarray of shape (n, 3)
        Where linear interpolation along the edges of the grid is zero.
    faces : ndarray of shape (f, 3)
        Oriented outwards. Both are empty where no sign changes.

    Notes
    -----
    Lorensen and Cline 1987. Points and faces are those of libigl's ``marching_cubes``, in its
    order; a test compares them.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.geometry.marching_cubes import marching_cubes
    >>> nodes = np.stack(np.meshgrid(*[np.arange(-2.0, 3.0)] * 3, indexing="ij")[::-1], axis=-1)
    >>> points, faces = marching_cubes(np.abs(nodes).sum(-1) - 1.5, nodes)
    >>> len(points), len(faces)
    (30, 56)
    """
    nz, ny, nx = values.shape
    inside = values <= 0
    code = np.zeros((nz - 1, ny - 1, nx - 1), dtype=np.uint8)
    for bit, (x, y, z) in enumerate(_CORNERS):
        window = inside[z : z + nz - 1, y : y + ny - 1, x : x + nx - 1]
        code |= window.astype(np.uint8) << np.uint8(bit)
    z, y, x = np.nonzero((code > 0) & (code < 255))  # the cells that the surface passes
    code = code[z, y, x]
    strides = np.array([1, nx, nx * ny])
    nodes_of = (np.column_stack([x, y, z]) @ strides)[:, None] + _CORNERS @ strides  # (cells, 8)
    ends = nodes_of[:, _EDGES]  # (cells, 12, 2)
    inside = inside.ravel()
    crossed = inside[ends[..., 0]] != inside[ends[..., 1]]
    # One vertex per edge, though up to four cells meet there; numbered as they are first met.
    pairs = np.sort(ends[crossed], axis=1)
    _, first, which = np.unique(pairs @ [nx * ny * nz, 1], return_index=True, return_inverse=True)
    order = np.argsort(first)
    vertex = np.zeros(crossed.shape, dtype=np.int64)
    vertex[crossed] = np.argsort(order)[which]
    a, b = ends[crossed][first[order]].T
    v, p = values.ravel(), nodes.reshape(-1, 3)
    t = v[a] / (v[a] - v[b])
    points = p[a] + t[:, None] * (p[b] - p[a])
    corners = np.take_along_axis(vertex, _TRIANGLES[code], axis=1).reshape(-1, 5, 3)
    return points, corners[np.arange(5) < _COUNTS[code, None]]
