# SPDX-License-Identifier: GPL-3.0-or-later
"""Do other programs read what we write, and we what they write?  Compared value by value with their own code.

    npm install --prefix TOOLS @playcanvas/splat-transform @sparkjsdev/spark three      (the first has Niantic's own SPZ library inside)
    python -m venv OTHERS && OTHERS/bin/pip install gsply imagecodecs usd-core "fourdgs[zstd]"
    python benchmarks/interchange.py --tools TOOLS --python OTHERS/bin/python

Each line: a file, who wrote it and who read it, and the largest difference between what we and they make of it: positions relative to
the model's extent, ln of scale, opacity, colour coefficients, and covariances relative to their own size (which rotations are part of:
the same Gaussian has several quaternions).  Ends with 1 where one is above its bound.  What is not installed is named, and passed over.
"""
from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "library"), str(ROOT / "tests" / "library" / "formats")]

import test_formats_ksplat  # noqa: E402
from interchange_with.python_packages import TIMES  # noqa: E402
from random_models import random_model  # noqa: E402

import fastgs_blender as fg  # noqa: E402
from fastgs_blender.formats.straight import logit  # noqa: E402
from fastgs_blender.formats.streamed_sog import with_level  # noqa: E402
from fastgs_blender.formats.turning import into_rdf, turned, with_axes  # noqa: E402
from fastgs_blender.util import rotations  # noqa: E402

WITH = ROOT / "benchmarks" / "interchange_with"
CLI = Path("node_modules/@playcanvas/splat-transform/bin/cli.mjs")
SPARK = Path("node_modules/@sparkjsdev/spark/dist/spark.module.js")
SH_C0 = 0.28209479177387814
BOUNDS = {"position": 1e-6, "scale": 1e-5, "opacity": 2e-6, "features": 1e-5, "covariance": 1e-4}
"""Of float32, and of the 1e-6 that splat-transform keeps opacities away from 0 and 1."""
HALF = {"scale": 2e-3, "opacity": 6e-4, "features": 4e-3, "covariance": 2e-2}
"""What Spark keeps: half floats, rotations in 10 bits."""
VIEWERS = {"covariance": 4e-2}
"""Of covariances in .splat: splat-transform reads a quaternion's byte as b / 127.5 - 1, antimatter15's viewer and we as (b - 128) / 128."""
CLOSE_TO_OPAQUE = {"opacity": 5e-5}
"""gsply keeps the logits of compressed PLY within -10..10."""
OURS = ("ours.ply", "ours.spz", "ours.splat", "ours.compressed.ply", "ours.sog")


def main(argv=None) -> None:
    """Prints the comparisons; ends with 1 if one fails."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tools", type=Path, default=Path("tools-node"), help="the folder that npm installed into")
    parser.add_argument("--python", type=Path, default=Path(sys.executable), help="a Python that has gsply, usd-core and fourdgs")
    parser.add_argument("--gaussians", type=int, default=5000)
    args = parser.parse_args(argv)
    good = []
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", fg.LossWarning)
        here = Path(folder)
        model = random_model(np.random.default_rng(7), args.gaussians, appearance="sh3", extent=5.0)
        for name in OURS:
            fg.save(model, here / name)
        for part in (splat_transform, niantic, spark, gsply, usd, fourdgs):
            good += [compare(*pair) for pair in part(args, here, model)]
    sys.exit(0 if all(good) else 1)


def _there(name: str, good: bool, how: str) -> bool:
    if not good:
        print(f"{name} is not there, so nothing is compared with it: {how}")
    return good


def splat_transform(args, folder: Path, model: fg.GaussianModel) -> Iterator[tuple]:
    """Both ways, every format that it has in common with us."""
    cli = args.tools / CLI
    if not _there("splat-transform", cli.is_file() and bool(shutil.which("node")), "npm install @playcanvas/splat-transform"):
        return
    rng = np.random.default_rng(8)
    fg.save(random_model(rng, args.gaussians, appearance="sh0", extent=5.0), folder / "plain.ply")

    def theirs(name: str, *options: str, source=None, tagged=()) -> Path:
        source = folder / (source or "ours.ply")
        command = ["node", str(cli), "-q", "-w", str(source), *tagged]
        if name.endswith("lod-meta.json"):  # here the options name other sources, which come first
            command += [*options, str(folder / name)]
        else:
            command += [str(folder / name), *options]
        subprocess.run(command, check=True, capture_output=True)
        return folder / name

    version = json.loads((cli.parents[1] / "package.json").read_text("utf-8"))["version"]
    as_they_are = int(version.partition(".")[0]) >= 3  # then SPZ's numbers are taken and written without turning them to PLY's axes

    def both(label: str, path: Path, more=()):
        found = fg.load(theirs(f"{path.name}.back.ply", source=path))
        return label, fg.load(path), _from_rub(found) if as_they_are and path.suffix == ".spz" else found, dict(more)

    for name in OURS:
        yield both(f"splat-transform reads our {name.removeprefix('ours')}", folder / name, VIEWERS if name.endswith(".splat") else ())
    for number in ("3", "4"):
        yield both(f".spz {number} of splat-transform", theirs(f"theirs{number}.spz", "--spz-version", number))
    yield both(".compressed.ply of splat-transform", theirs("theirs.compressed.ply"))
    yield both(".sog of splat-transform, no SH", theirs("theirs.sog", "-g", "cpu", source=folder / "plain.ply"))
    yield ".glb of splat-transform", fg.load(theirs("theirs.glb")), model, {}
    for level in (0, 1, 2):
        path = folder / f"level{level}.ksplat"
        path.write_bytes(test_formats_ksplat.file([test_formats_ksplat.gaussians(rng, args.gaussians, 2)], level)[0])
        yield both(f"splat-transform reads .ksplat {level}", path)
    if as_they_are:  # older ones write streamed SOG, and do not read it
        yield from _streamed(folder, theirs)


def _streamed(folder: Path, theirs: Callable) -> Iterator[tuple]:
    """Each level of a scene in chunks, without its environment, in the order of the chunks."""
    levels = ("plain.ply", "coarse.ply")
    plain = fg.load(folder / "plain.ply")
    fg.save(plain.take(slice(0, None, 4)), folder / "coarse.ply")
    fg.save(plain.take(slice(0, 50)), folder / "around.ply")
    (folder / "scene").mkdir()
    sources = [part for number, name in enumerate(levels) for part in (str(folder / name), "-l", str(number))]
    theirs("scene/lod-meta.json", *sources[3:], str(folder / "around.ply"), "-l", "-1", "--lod-chunk-count", "1", "--lod-chunk-extent", "2",
           "-g", "cpu", source=levels[0], tagged=sources[1:3])
    for level in range(len(levels)):
        ours = fg.load(with_level(folder / "scene" / "lod-meta.json", level))
        back = fg.load(theirs(f"level{level}.ply", source=folder / "scene" / "lod-meta.json", tagged=("-L", str(level))))
        yield f"streamed SOG of splat-transform, {level}", ours.take(slice(0, len(ours) - 50)), back, {}


def niantic(args, folder: Path, model: fg.GaussianModel) -> Iterator[tuple]:
    """Both ways, with harmonics of degree 4, which none of the others has."""
    modules = (args.tools / "node_modules").resolve()
    if not _there("Niantic's library", (modules / "@adobe/spz").is_dir() and bool(shutil.which("node")), "npm install @adobe/spz"):
        return

    def library(*arguments) -> None:
        subprocess.run(["node", str(WITH / "spz.mjs"), str(modules), *map(str, arguments)], check=True, capture_output=True)

    def table(m: fg.GaussianModel) -> np.ndarray:
        return np.concatenate([m.position, m.scale, rotations.unit(m.rotation)[:, [1, 2, 3, 0]], m.opacity[:, None], m.features], 1)

    four = random_model(np.random.default_rng(10), args.gaussians, appearance="sh4", extent=5.0)
    four.features = np.clip(four.features, -0.9, 0.9)
    table(four).astype("<f4").tofile(folder / "rows.bin")
    for version in (3, 4):
        library("write", folder / "rows.bin", folder / "four.spz", version, "RUB")
        yield _as_niantic(f".spz {version} of Niantic's library, degree 4", folder / "four.spz", library)
    fg.save(four, folder / "ours4.spz")
    yield _as_niantic("Niantic's library reads our .spz, degree 4", folder / "ours4.spz", library)


def _as_niantic(label: str, path: Path, library: Callable) -> tuple:
    library("read", path, path.with_suffix(".bin"))
    rows = np.fromfile(path.with_suffix(".bin"), "<f4").reshape(-1, 86)
    theirs = fg.GaussianModel(position=rows[:, :3], scale=rows[:, 3:6], rotation=rows[:, [9, 6, 7, 8]], features=rows[:, 11:],
                              opacity=np.clip(rows[:, 10], -30, 30), appearance=fg.SH(4))
    return label, fg.load(path), theirs, {}


def spark(args, folder: Path, model: fg.GaussianModel) -> Iterator[tuple]:
    """What it reads of ours, but for higher harmonics, which it packs."""
    if not _there("Spark", (args.tools / SPARK).is_file() and bool(shutil.which("node")), "npm install @sparkjsdev/spark three"):
        return
    for name in OURS:
        out = folder / "spark.bin"
        subprocess.run(["node", str(WITH / "spark.mjs"), str((args.tools / "node_modules").resolve()), str(folder / name), str(out)],
                       check=True, capture_output=True)
        rows = np.fromfile(out, "<f4").reshape(-1, 14).astype(np.float64)
        found = fg.GaussianModel(position=rows[:, :3], scale=np.log(rows[:, 3:6]), rotation=rows[:, [9, 6, 7, 8]],
                                 opacity=np.clip(logit(rows[:, 10]), -30, 30), features=(rows[:, 11:] - 0.5) / SH_C0, appearance=fg.SH(0))
        ours = fg.load(folder / name)
        width = 3 if isinstance(ours.appearance, fg.SH) else ours.features.shape[1]
        ours = replace(ours, features=ours.features[:, :width], appearance=fg.SH(0) if width == 3 and isinstance(
            ours.appearance, fg.SH) else ours.appearance)
        yield f"Spark reads our {name.removeprefix('ours')}", ours, _from_rub(found) if name.endswith(".spz") else found, HALF | (
            VIEWERS if name.endswith(".splat") else {})


def gsply(args, folder: Path, model: fg.GaussianModel) -> Iterator[tuple]:
    """Both ways: PLY, compressed PLY and SPZ; SOG as it reads it."""
    read = _python(args, folder, "gsply")
    if read is None:
        return
    for name in ("ours.ply", "ours.compressed.ply", "ours.spz", "ours.sog"):
        found = _model(read(folder / name))
        found = _from_rub(found) if name.endswith(".spz") else found
        yield f"gsply reads our {name.removeprefix('ours')}", fg.load(folder / name), found, CLOSE_TO_OPAQUE
    arrays = {name: getattr(model, name) for name in ("position", "rotation", "scale", "opacity", "features")}
    np.savez(folder / "model.npz", **arrays)
    for name in ("gsply.ply", "gsply.compressed.ply", "gsply.spz"):
        _run(args, "gsply", folder / name, folder / "model.npz", "--write")
        found = _model(read(folder / name))
        found = _from_rub(found) if name.endswith(".spz") else found
        yield f"{name.removeprefix('gsply')} of gsply", fg.load(folder / name), found, CLOSE_TO_OPAQUE


def usd(args, folder: Path, model: fg.GaussianModel) -> Iterator[tuple]:
    """What Pixar's library from the registry reads of a .usdc that is written with Blender's or with the same."""
    read = _python(args, folder, "pxr")
    if read is None:
        return
    writer = f"import fastgs_blender as fg; fg.save(fg.load({str(folder / 'ours.ply')!r}), {str(folder / 'ours.usdc')!r})"
    subprocess.run([str(args.python), "-W", "ignore", "-c", writer], check=True, cwd=ROOT)
    found = with_axes(replace(_model(read(folder / "ours.usdc")), axes="RFU"), "RDF")
    yield "usd-core reads our .usdc", model, found, {}


def fourdgs(args, folder: Path, model: fg.GaussianModel) -> Iterator[tuple]:
    """Its own state of our file at several times."""
    read = _python(args, folder, "fourdgs")
    if read is None:
        return
    rng = np.random.default_rng(9)
    moving = random_model(rng, args.gaussians, basis="line", temporal="radial", appearance="sh1", clip=fg.Clip(60, 30.0))
    fg.save(moving, folder / "ours.4dgs")
    ours, theirs = fg.load(folder / "ours.4dgs"), read(folder / "ours.4dgs")
    for number, t in enumerate(TIMES):
        s = fg.slice_model(ours, t, cull=False)
        seen = s.opacity > 1e-6
        pair = [fg.GaussianModel(position=p[seen], rotation=q[seen], scale=scale[seen], opacity=np.clip(logit(o[seen]), -30, 30),
                                 features=np.zeros((seen.sum(), 3))) for p, q, scale, o in (
            (s.position, s.rotation, np.log(s.scale), s.opacity),
            (theirs["position"][number], theirs["rotation"][number][:, [3, 0, 1, 2]], theirs["scale"], theirs["opacity"][number][:, 0]))]
        yield f"fourdgs reads our .4dgs at {t:.2f}", *pair, {"opacity": 1e-5}


def _python(args, folder: Path, package: str) -> Callable | None:
    """read(path) -> arrays, by a package in the other Python; None where it lacks it."""
    there = subprocess.run([str(args.python), "-c", f"import {package}"], capture_output=True, check=False).returncode == 0
    if not _there(package, there, f"pip install {'usd-core' if package == 'pxr' else package}"):
        return None

    def read(path: Path) -> dict:
        _run(args, package, path, folder / "read.npz")
        return dict(np.load(folder / "read.npz"))

    return read


def _run(args, package: str, *more) -> None:
    done = subprocess.run([str(args.python), str(WITH / "python_packages.py"), package, *map(str, more)], capture_output=True, text=True,
                          check=False)
    if done.returncode:
        sys.exit(f"{package} failed on {more[0]}: {done.stderr[-2000:]}")


def _model(arrays: dict) -> fg.GaussianModel:
    return fg.GaussianModel(**arrays, appearance=fg.SH(round((arrays["features"].shape[1] / 3) ** 0.5) - 1))


def _from_rub(model: fg.GaussianModel) -> fg.GaussianModel:
    """What SPZ says in its own axes, right, up and back."""
    return turned(model, into_rdf("RUB"))


def compare(label: str, ours: fg.GaussianModel, theirs: fg.GaussianModel, more: dict[str, float]) -> bool:
    """Print the differences of two models, and whether all are within their bounds."""
    if len(ours) != len(theirs):
        print(f"{label:36} {len(ours)} and {len(theirs)} Gaussians: DIFFERENT")
        return False
    a, b = (fg.slice_model(m, 0, cull=False) for m in (ours, theirs))
    first, second = covariances(a), covariances(b)
    size = np.abs(first).max((1, 2), keepdims=True)
    if isinstance(ours.appearance, fg.RGB):
        a.features[:] = (a.features - 0.5) / SH_C0
        if isinstance(theirs.appearance, fg.RGB):
            b.features[:] = (b.features - 0.5) / SH_C0
    found = {"position": np.abs(a.position - b.position).max() / np.ptp(a.position), "scale": np.abs(np.log(a.scale / b.scale)).max(),
             "opacity": np.abs(a.opacity - b.opacity).max(),
             "features": np.abs(a.features - b.features).max() if a.features.shape == b.features.shape else np.inf,
             "covariance": (np.abs(first - second) / size).max()}
    good = all(found[key] <= limit for key, limit in (BOUNDS | more).items())
    print(f"{label:36} " + "  ".join(f"{key} {value:.1e}" for key, value in found.items()) + ("" if good else "  DIFFERENT"))
    return good


def covariances(s: fg.Slice) -> np.ndarray:
    """Covariance matrices [N, 3, 3]."""
    turn = rotations.to_matrices(s.rotation)
    return turn @ (s.scale[:, :, None] ** 2 * np.swapaxes(turn, 1, 2))


if __name__ == "__main__":
    main()
