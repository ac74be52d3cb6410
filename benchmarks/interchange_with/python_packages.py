# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads or writes a file with other programs' Python packages: python python_packages.py PACKAGE FILE ARRAYS.npz [--write]

PACKAGE is gsply, pxr (usd-core) or fourdgs.  The arrays, of N Gaussians as PLY files have them: position, rotation (w x y z), scale (ln),
opacity (logit), features [N, 3 B] (coefficient by coefficient); of fourdgs at TIMES of the clip, with [T, N, ...] and opacities of 0
for what is not there.  Nothing of FAST-GS is imported: this is what the others make of the file.
"""
from __future__ import annotations

import sys

import numpy as np

TIMES = np.linspace(0.05, 0.95, 7)


def gsply(path: str) -> dict:
    """A PLY, compressed PLY, SPZ or SOG."""
    import gsply

    read = gsply.read_spz if path.endswith(".spz") else gsply.sogread if path.endswith(".sog") else gsply.plyread
    data = read(path)
    rest = np.zeros((len(data.means), 0, 3)) if data.shN is None else data.shN
    return {"position": data.means, "rotation": data.quats, "scale": data.scales, "opacity": data.opacities,
            "features": np.concatenate([data.sh0[:, None], rest], 1).reshape(len(data.means), -1)}


def write_gsply(path: str, arrays) -> None:
    """The same the other way."""
    import gsply

    rest = arrays["features"].reshape(len(arrays["position"]), -1, 3)[:, 1:]
    parts = {"scales": arrays["scale"], "quats": arrays["rotation"], "opacities": arrays["opacity"], "sh0": arrays["features"][:, :3],
             "shN": np.ascontiguousarray(rest)}
    plain = f"{path}.plain.ply"
    gsply.plywrite(plain, arrays["position"], **parts)
    data = gsply.plyread(plain)
    if path.endswith(".spz"):
        gsply.write_spz(path, data)
    else:
        gsply.plywrite(path, data, compressed=path.endswith(".compressed.ply"))


def pxr(path: str) -> dict:
    """The one ParticleField of a stage at its first time."""
    from pxr import Usd

    stage = Usd.Stage.Open(path)
    prim, = (p for p in stage.Traverse() if p.GetTypeName() == "ParticleField3DGaussianSplat")
    values = {name: np.array(prim.GetAttribute(name).Get(Usd.TimeCode.EarliestTime()), np.float64)
              for name in ("positions", "scales", "opacities", "radiance:sphericalHarmonicsCoefficients")}
    turns = [(q.GetReal(), *q.GetImaginary()) for q in prim.GetAttribute("orientations").Get(Usd.TimeCode.EarliestTime())]
    n, opacity = len(turns), values["opacities"]
    return {"position": values["positions"], "rotation": np.array(turns), "scale": np.log(values["scales"]),
            "opacity": np.log(opacity / (1 - opacity)), "features": values["radiance:sphericalHarmonicsCoefficients"].reshape(n, -1)}


def fourdgs(path: str) -> dict:
    """A .4dgs at TIMES."""
    import fourdgs

    scene = fourdgs.read(path)
    n, found = len(scene.gaussians.scales), {"position": [], "rotation": [], "opacity": []}
    for t in TIMES:
        now = scene.state_at(t * scene.duration_sec)
        seen = np.asarray(now["indices"], int)
        for name, key, width in (("position", "centers", 3), ("rotation", "orientations", 4), ("opacity", "opacity", 1)):
            values = np.zeros((n, width))
            values[seen] = np.asarray(now[key]).reshape(len(seen), width)
            found[name].append(values)
    return {name: np.stack(values) for name, values in found.items()} | {"scale": np.log(scene.gaussians.scales)}


if __name__ == "__main__":
    package, file, table, *more = sys.argv[1:]
    if more:
        write_gsply(file, dict(np.load(table)))
    else:
        np.savez(table, **{"gsply": gsply, "pxr": pxr, "fourdgs": fourdgs}[package](file))
