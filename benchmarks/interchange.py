# SPDX-License-Identifier: GPL-3.0-or-later
"""Do other programs read what we write, and we what they write?  Compared value by value with splat-transform.

    npm install --prefix TOOLS @playcanvas/splat-transform      (it has Niantic's own SPZ library inside)
    python benchmarks/interchange.py --tools TOOLS

Each line: a file, who wrote it, and the largest difference between what we and they make of it: positions relative to the model's
extent, ln of scale, opacity, colour coefficients, and covariances relative to their own size (which rotations are part of: the same
Gaussian has several quaternions).  Ends with 1 where one is above its bound.  Tools that are not installed are named, and passed over.
"""
from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "library"), str(ROOT / "tests" / "library" / "formats")]

import test_formats_ksplat  # noqa: E402
from random_models import random_model  # noqa: E402

import fastgs_blender as fg  # noqa: E402
from fastgs_blender.util import rotations  # noqa: E402

CLI = Path("node_modules/@playcanvas/splat-transform/bin/cli.mjs")
BOUNDS = {"position": 1e-6, "scale": 1e-5, "opacity": 2e-6, "features": 1e-5, "covariance": 1e-4}
"""Of float32, and of the 1e-6 that splat-transform keeps opacities away from 0 and 1."""
VIEWERS = 4e-2
"""Of covariances in .splat: splat-transform reads a quaternion's byte as b / 127.5 - 1, antimatter15's viewer and we as (b - 128) / 128."""


def main(argv=None) -> None:
    """Prints the comparisons; ends with 1 if one fails."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tools", type=Path, default=Path("tools-node"), help="the folder that npm installed into")
    parser.add_argument("--gaussians", type=int, default=5000)
    args = parser.parse_args(argv)
    cli = args.tools / CLI
    if not cli.is_file() or not shutil.which("node"):
        print(f"splat-transform is not there ({cli}, and node): nothing is compared.  npm install --prefix {args.tools} "
              "@playcanvas/splat-transform brings it.")
        return
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", fg.LossWarning)
        good = [compare(*pair) for pair in pairs(cli, Path(folder), args.gaussians)]
    sys.exit(0 if all(good) else 1)


def pairs(cli: Path, folder: Path, count: int):
    """(label, the model as we read it, as they read it, its bound of covariances) for every format and writer."""
    rng = np.random.default_rng(7)
    model = random_model(rng, count, appearance="sh3", extent=5.0)
    plain = random_model(rng, count, appearance="sh0", extent=5.0)
    fg.save(model, folder / "model.ply")
    fg.save(plain, folder / "plain.ply")

    def theirs(name: str, *options: str, source=None) -> Path:
        source = source or folder / "model.ply"
        subprocess.run(["node", str(cli), "-q", "-w", str(source), str(folder / name), *options], check=True, capture_output=True)
        return folder / name

    def both(label: str, path: Path, bound: float = BOUNDS["covariance"]):
        return label, fg.load(path), fg.load(theirs(f"{path.name}.back.ply", source=path)), bound

    for name in ("ours.spz", "ours.splat", "ours.compressed.ply", "ours.sog"):
        fg.save(model, folder / name)
        yield both(f"{name.removeprefix('ours')} of ours", folder / name, VIEWERS if name.endswith(".splat") else BOUNDS["covariance"])
    for version in ("3", "4"):
        yield both(f".spz {version} of theirs", theirs(f"theirs{version}.spz", "--spz-version", version))
    yield both(".compressed.ply of theirs", theirs("theirs.compressed.ply"))
    yield both(".sog of theirs, without SH", theirs("theirs.sog", "-g", "cpu", source=folder / "plain.ply"))
    yield ".glb of theirs", fg.load(theirs("theirs.glb")), model, BOUNDS["covariance"]
    for level in (0, 1, 2):
        path = folder / f"level{level}.ksplat"
        path.write_bytes(test_formats_ksplat.file([test_formats_ksplat.gaussians(rng, count, 2)], level)[0])
        yield both(f".ksplat, level {level}", path)


def compare(label: str, ours: fg.GaussianModel, theirs: fg.GaussianModel, bound: float) -> bool:
    """Print the differences of two models, and whether all are within their bounds."""
    if len(ours) != len(theirs):
        print(f"{label:28} {len(ours)} and {len(theirs)} Gaussians: DIFFERENT")
        return False
    a, b = (fg.slice_model(m, 0, cull=False) for m in (ours, theirs))
    first, second = covariances(a), covariances(b)
    size = np.abs(first).max((1, 2), keepdims=True)
    if isinstance(ours.appearance, fg.RGB):
        a.features[:] = (a.features - 0.5) / 0.28209479177387814
    found = {"position": np.abs(a.position - b.position).max() / np.ptp(a.position), "scale": np.abs(np.log(a.scale / b.scale)).max(),
             "opacity": np.abs(a.opacity - b.opacity).max(),
             "features": np.abs(a.features - b.features).max() if a.features.shape == b.features.shape else np.inf,
             "covariance": (np.abs(first - second) / size).max()}
    good = all(found[key] <= limit for key, limit in (BOUNDS | {"covariance": bound}).items())
    print(f"{label:28} " + "  ".join(f"{key} {value:.1e}" for key, value in found.items()) + ("" if good else "  DIFFERENT"))
    return good


def covariances(s: fg.Slice) -> np.ndarray:
    """Covariance matrices [N, 3, 3]."""
    turn = rotations.to_matrices(s.rotation)
    return turn @ (s.scale[:, :, None] ** 2 * np.swapaxes(turn, 1, 2))


if __name__ == "__main__":
    main()
