# SPDX-License-Identifier: GPL-3.0-or-later
"""PLY files of every make, assembled from their parts without the library's help."""
from __future__ import annotations

import numpy as np

FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
CODES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4", "double": "f8"}
INRIA = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
STG = ["x", "y", "z", "trbf_center", "trbf_scale", "nx", "ny", "nz", *(f"motion_{i}" for i in range(9)), "f_dc_0", "f_dc_1", "f_dc_2",
       "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3", "omega_0", "omega_1", "omega_2", "omega_3"]
STG_FULL = STG[:20] + ["f_dc_3", "f_dc_4", "f_dc_5"] + STG[20:] + ["f_t_0", "f_t_1", "f_t_2"]


def columns(rng: np.random.Generator, names, n: int = 6) -> dict[str, np.ndarray]:
    """Random float columns by name."""
    return {name: rng.normal(size=n).astype(np.float32) for name in names}


def element(name: str, table: dict[str, np.ndarray], order: str, types: dict[str, str]) -> tuple[list[str], bytes]:
    """Header lines and body of an element without lists."""
    count = len(next(iter(table.values())))
    lines = [f"element {name} {count}", *(f"property {types.get(key, 'float')} {key}" for key in table)]
    if not order:
        rows = zip(*(values.tolist() for values in table.values()), strict=True)
        return lines, "".join(" ".join(repr(v) for v in row) + "\n" for row in rows).encode()
    body = np.zeros(count, [(key, order + CODES[types.get(key, "float")]) for key in table])
    for key, values in table.items():
        body[key] = values
    return lines, body.tobytes()


def faces(order: str, name: str = "face") -> tuple[list[str], bytes]:
    """An element with lists of unequal length."""
    lines = [f"element {name} 2", "property list uchar int vertex_indices", "property uchar flag"]
    if not order:
        return lines, b"3 0 1 2 7\n2 1 0 7\n"
    integers = np.arange(3, dtype=order + "i4").tobytes()
    return lines, b"\x03" + integers + b"\x07" + b"\x02" + integers[:8] + b"\x07"


def ply(table: dict[str, np.ndarray], kind: str = "binary_little_endian", comments=(), types=None, before=(), after=(),
        newline="\n") -> bytes:
    """A PLY file with these vertices; before and after: elements as element() and faces() give them."""
    elements = [*before, element("vertex", table, FORMATS[kind], types or {}), *after]
    lines = ["ply", f"format {kind} 1.0", *(f"comment {text}" for text in comments)]
    lines += [line for part, _ in elements for line in part] + ["end_header", ""]
    return newline.join(lines).encode() + b"".join(body for _, body in elements)
