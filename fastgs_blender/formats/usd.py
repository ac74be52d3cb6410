# SPDX-License-Identifier: GPL-3.0-or-later
"""OpenUSD's ParticleField3DGaussianSplat (OpenUSD 26.03), static or with time samples: .usdc, .usda, .usd, .usdz.

A prim has positions, orientations (w x y z), scales (standard deviations), opacities (0..1), and the coefficients of spherical harmonics
coefficient by coefficient, radiance:sphericalHarmonicsDegree and radiance:sphericalHarmonicsCoefficients, each perhaps under its name for
half precision, which ends in "h".  All such prims of the stage are read, where their parents put them; names of several become parts, and
each part is written as a prim.  The stage's up axis says the axes.

Files are read and written by Pixar's own library (pxr), which Blender from blender.org brings along; without it they are refused.  Only the
file itself is opened: what it refers to in other files is left out.
"""
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..model.appearance import SH
from ..model.gaussians import Clip, GaussianModel
from ..model.parts import pieces, told_apart
from ..model.sequence import Source
from ..model.slicing import sigmoid
from ..util import rotations
from ..util.errors import FastGSError
from ..util.outputs import replacing
from ..util.zip_files import members
from .base import OPAQUE, Loader, generator
from .scenes import placed, together
from .sequences import within
from .static import StaticFormat
from .turning import with_axes

KIND = "ParticleField3DGaussianSplat"
DEGREE, COEFFICIENTS = "radiance:sphericalHarmonicsDegree", "radiance:sphericalHarmonicsCoefficients"
MOST_PRIMS, MOST_FRAMES = 10_000, 1_000_000_000
AXES = {"Y": "RUB", "Z": "RFU"}


class Usd(StaticFormat):
    name = "OpenUSD ParticleField"
    says_axes = empty = keeps_parts = True
    reads = (".usdc", ".usda", ".usd", ".usdz")

    def __init__(self, extension: str = ".usdc") -> None:
        self.extensions = (extension,)

    def sniff(self, head: bytes, path: Path) -> bool:
        return head.startswith((b"PXR-USDC", b"#usda")) or any(name.endswith((".usdc", ".usda", ".usd")) for name in members(head, path))

    def load(self, path: Path) -> GaussianModel:
        stage, prims = _opened(path)
        times = _times(prims)
        return _model(stage, prims, times[0] if len(times) else None)

    def open(self, path: Path, load: Loader) -> Source:
        stage, prims = _opened(path)
        times = _times(prims)
        if len(times) < 2:
            return load(path)
        step = float(np.diff(times).min())
        with np.errstate(all="ignore"):  # times may be as near to each other as numbers go
            at = np.rint((times - times[0]) / step)
            rate = stage.GetTimeCodesPerSecond() / step
        if not at[-1] <= MOST_FRAMES:
            raise FastGSError("the times of its samples are next to equal; export them frame by frame.")
        clip = Clip(int(at[-1]) + 1, rate if 0 < rate < 1e6 else 24.0)
        return within(path, clip, at, lambda i: _model(*_opened(path), time=float(times[i])))

    def write(self, model: GaussianModel, targets: list[Path]) -> None:
        write_frames(targets[-1], self.extensions[0], [(None, model)])


def save_samples(path: Path, frames: Iterable[tuple[float, GaussianModel]], fps: float) -> None:
    """Write static models at times in frames as one .usdc, as save() writes one: aside, then renamed.  Raises FastGSError."""
    try:
        with replacing([path]) as targets:
            write_frames(targets[0], ".usdc", ((float(time), Usd().fit(model)[0]) for time, model in frames), fps)
    except (FastGSError, OSError) as error:
        raise FastGSError(f"cannot write {path}: {error}") from error


def write_frames(path: Path, extension: str, frames: Iterable[tuple[float | None, GaussianModel]], fps: float = 24.0) -> None:
    """Write static models, as StaticFormat.fit() returns them, as samples of prims at times in frames; a time of None: no samples.

    Each of their parts is a prim, which has no Gaussians at the times at which it is not shown.
    extension  .usdc (binary) or .usda (text), whatever the path's own is
    """
    pxr = _library()
    layer = pxr.Sdf.Layer.CreateAnonymous(extension)
    stage = pxr.Usd.Stage.Open(layer)
    pxr.UsdGeom.SetStageUpAxis(stage, "Z")
    pxr.UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    layer.comment = f"Written by {generator()}"
    stage.SetDefaultPrim(stage.DefinePrim("/Splats", "Xform"))
    prims, times = dict[str, Any](), list[float]()
    for time, model in frames:
        model = with_axes(model, "RFU")
        shown = dict(pieces(model.parts, len(model)))
        for name in [name for name in shown if name not in prims]:
            prims[name] = stage.DefinePrim(_path(pxr, name, prims), KIND)
            for earlier in times:
                _put(pxr, prims[name], model.take([]), pxr.Usd.TimeCode(earlier))
        for name, prim in prims.items():
            _put(pxr, prim, model.take(shown.get(name, [])), pxr.Usd.TimeCode.Default() if time is None else pxr.Usd.TimeCode(time))
        times += [] if time is None else [time]
    if times:
        stage.SetStartTimeCode(min(times))
        stage.SetEndTimeCode(max(times))
        stage.SetTimeCodesPerSecond(fps)
        stage.SetFramesPerSecond(fps)
    # the library chooses the format by the name, and what is written has a temporary one
    named = path.with_name(path.name + extension)
    try:
        if not layer.Export(str(named)):
            raise FastGSError("it could not be written; check the folder and the space on its disk.")
        named.replace(path)
    finally:
        named.unlink(missing_ok=True)


def _path(pxr: ModuleType, name: str, prims: dict[str, Any]) -> str:
    """The path of another prim for the Gaussians of a part, by its name as far as USD allows it."""
    wanted, taken = pxr.Tf.MakeValidIdentifier(name or "Gaussians"), {prim.GetName() for prim in prims.values()}
    return "/Splats/" + next(each for number in range(len(prims) + 1) if (each := wanted + (f"_{number}" if number else "")) not in taken)


def _put(pxr: ModuleType, prim: Any, model: GaussianModel, when: Any) -> None:
    """Give a prim Gaussians at a time."""
    turn = rotations.unit(model.rotation.astype(np.float64)).astype(np.float32)
    values = {
        "positions": ("Point3fArray", _array(pxr.Vt.Vec3fArray, model.position)),
        "orientations": ("QuatfArray", _array(pxr.Vt.QuatfArray, turn[:, [1, 2, 3, 0]])),
        "scales": ("Float3Array", _array(pxr.Vt.Vec3fArray, np.exp(model.scale.astype(np.float64)))),
        "opacities": ("FloatArray", _array(pxr.Vt.FloatArray, sigmoid(model.opacity))),
        COEFFICIENTS: ("Float3Array", _array(pxr.Vt.Vec3fArray, model.features.reshape(-1, 3))),
    }
    for name, (kind, value) in values.items():
        prim.CreateAttribute(name, getattr(pxr.Sdf.ValueTypeNames, kind), False).Set(value, when)
    prim.CreateAttribute(DEGREE, pxr.Sdf.ValueTypeNames.Int, False).Set(model.appearance.degree, when)
    low, high = (model.position.min(0), model.position.max(0)) if len(model) else (np.zeros(3), np.zeros(3))
    prim.CreateAttribute("extent", pxr.Sdf.ValueTypeNames.Float3Array, False).Set(_array(pxr.Vt.Vec3fArray, np.stack([low, high])), when)


def _library() -> ModuleType:
    """Pixar's modules; raises FastGSError where they are not there."""
    try:
        import pxr
        from pxr import Gf, Sdf, Usd, UsdGeom, Vt  # noqa: F401 (they become members of pxr)
    except ImportError as error:
        raise FastGSError("Pixar's USD library (pxr), which this format needs, is not installed; Blender from blender.org brings it along, "
                          "and elsewhere it comes with usd-core.") from error
    return pxr


def _opened(path: Path) -> tuple[Any, list]:
    """The stage of a file alone, and its prims of Gaussians; raises FastGSError."""
    pxr = _library()
    try:
        layer = pxr.Sdf.Layer.OpenAsAnonymous(str(path))
        if layer is None:
            raise FastGSError("it is damaged, or no USD file; copy or export it again.")
        for prim in layer.rootPrims:
            _without_references(prim)
        layer.subLayerPaths.clear()
        stage = pxr.Usd.Stage.Open(layer, pxr.Usd.Stage.LoadNone)
    except pxr.Tf.ErrorException as error:
        raise FastGSError("it is damaged, or no USD file; copy or export it again.") from error
    prims = []
    for prim in stage.Traverse():
        prims += [prim] if prim.GetTypeName() == KIND else []
        if len(prims) > MOST_PRIMS:
            raise FastGSError(f"it has more than {MOST_PRIMS} prims of Gaussians; join some of them.")
    if not prims:
        raise FastGSError(f"it is a USD file without Gaussians ({KIND}); in Blender use File > Import > Universal Scene Description.")
    return stage, prims


def _without_references(spec: Any) -> None:
    """Take what leads to other files out of a prim, its variants and those below it."""
    spec.ClearReferenceList()
    spec.ClearPayloadList()
    spec.ClearInfo("clips")
    for child in spec.nameChildren:
        _without_references(child)
    for choices in spec.variantSets.values():
        for variant in choices.variants.values():
            _without_references(variant.primSpec)


def _attribute(prim: Any, name: str) -> Any:
    """The attribute of a name, or of its half precision."""
    for each in (name, name + "h"):
        found = prim.GetAttribute(each)
        if found and found.HasValue():
            return found
    return None


def _value(attribute: Any, when: Any) -> Any:
    """The value of an attribute; raises FastGSError for the name of a file, which USD would look for, perhaps on another machine."""
    sdf = _library().Sdf
    for spec in attribute.GetPropertyStack(when):
        _, low, high = spec.layer.GetBracketingTimeSamplesForPath(spec.path, when.GetValue())
        stored = [spec.default, *(spec.layer.QueryTimeSample(spec.path, time) for time in {low, high})]
        if any(isinstance(value, (sdf.AssetPath, sdf.AssetPathArray)) for value in stored):
            raise FastGSError(f"{attribute.GetPath()} names a file where numbers should be; export it again.")
    return attribute.Get(when)


def _times(prims: Iterable[Any]) -> np.ndarray:
    """All times at which an attribute of the Gaussians has a sample, increasing."""
    names = ("positions", "orientations", "scales", "opacities", COEFFICIENTS)
    found = {time for prim in prims for name in names if (a := _attribute(prim, name)) is not None for time in a.GetTimeSamples()}
    return np.array(sorted(time for time in found if abs(time) < 1e9))


def _model(stage: Any, prims: Iterable[Any], time: float | None) -> GaussianModel:
    """All Gaussians at a time."""
    pxr = _library()
    when = pxr.Usd.TimeCode.EarliestTime() if time is None else pxr.Usd.TimeCode(time)
    places = pxr.UsdGeom.XformCache(when)
    models, names = [], []
    for prim in prims:
        place = np.array(places.GetLocalToWorldTransform(prim), np.float64).T
        models.append(placed(_gaussians(prim, when), place))
        names.append((prim.GetName(), len(models[-1])))
    axes = AXES.get(str(pxr.UsdGeom.GetStageUpAxis(stage)), "RUB")
    return replace(together(models), axes=axes, parts=told_apart(names))


def _gaussians(prim: Any, when: Any) -> GaussianModel:
    def read(name: str, width: int, default: ArrayLike | None = None) -> np.ndarray:
        attribute = _attribute(prim, name)
        value = None if attribute is None else _value(attribute, when)
        if value is None:
            if default is None:
                raise FastGSError(f"its prim {prim.GetPath()} has no {name}; export it again.")
            return np.broadcast_to(np.asarray(default, np.float32), (len(position), width))
        array = np.array(value, np.float32)
        if array.size and (array.ndim != (2 if width > 1 else 1) or (width > 1 and array.shape[1] != width)):
            raise FastGSError(f"the {name} of its prim {prim.GetPath()} are of another type than they should be; export it again.")
        return array.reshape(-1, width)

    position = read("positions", 3)
    n = len(position)
    attribute = prim.GetAttribute(DEGREE)
    degree = _value(attribute, when) if attribute and attribute.HasValue() else 0
    if not isinstance(degree, int) or not 0 <= degree <= 4:
        raise FastGSError(f"its degree of spherical harmonics cannot be {degree!r}; at most 4 are read.")
    opacity = read("opacities", 1, 1.0)[:, 0].astype(np.float64)
    arrays: dict[str, Any] = {"rotation": read("orientations", 4, (0, 0, 0, 1))[:, [3, 0, 1, 2]], "scale": read("scales", 3, (1, 1, 1))}
    coefficients = read(COEFFICIENTS, 3)
    count = (degree + 1) ** 2
    if len(coefficients) != n * count or len(opacity) != n or any(len(array) != n for array in arrays.values()):
        raise FastGSError(f"the attributes of its prim {prim.GetPath()} differ in length; export it again.")
    with np.errstate(all="ignore"):
        logit = np.clip(np.log(opacity) - np.log1p(-opacity), -OPAQUE, OPAQUE)
        arrays["scale"] = np.log(arrays["scale"].astype(np.float64))
    return GaussianModel(position, **arrays, opacity=logit, features=coefficients.reshape(n, 3 * count), appearance=SH(degree))


def _array(kind: Any, values: np.ndarray) -> Any:
    return kind.FromNumpy(np.ascontiguousarray(values, np.float32))
