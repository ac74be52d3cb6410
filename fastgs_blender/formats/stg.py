# SPDX-License-Identifier: GPL-3.0-or-later
"""The PLY of Spacetime Gaussians (STG), full and lite, and the same layout with Fourier motion (FAST-GS).

Columns: x y z, trbf_center, trbf_scale (ln of the width), nx ny nz, motion_*, f_dc_*, opacity, scale_0..2, rot_0..3, omega_0..3, f_t_*.
* motion_0..8: three powers of t - trbf_center, x y z each.  Any other number of columns is Fourier in t, axis after axis:
  (w0) sin1 cos1 sin2 cos2 ..., with or without the constant w0, which joins the position.  Our comments tell the phase
  and a linear term (at the end); half-period cosines are a Fourier series of half the frequency whose sines are 0.
* lite: f_dc_0..2 is RGB.  full: f_dc_0..5 and f_t_0..2 are features, and the decoder lies beside the file, as .pt.
  STG gives it the sum of features as blending leaves it; our comments tell where a model's is given their mean.
"""
import warnings
from pathlib import Path

import numpy as np

from ..model.appearance import RGB, Appearance, Features
from ..model.gaussians import Clip, GaussianModel
from ..model.motion import Basis, Cosine, Fourier, Polynomial
from ..model.temporal import Radial
from ..util.arguments import shown
from ..util.errors import FastGSError, LossWarning, printable
from ..util.reading import reading
from . import cfg_args, ply, torch_zip
from .base import STEEP, Format, generator
from .description import comments, from_comments, restored
from .fitting import bell_opacity, linear_rotation, plain_colour, polynomial_motion
from .inria import NORMAL, POSITION, ROTATION, SCALE
from .supersplat_ply import is_dynamic

KEYS = ("basis", "rotation_basis", "temporal", "appearance", "raster", "clip", "axes", "colour_space", "provenance", "surroundings")
OMEGA = ("omega_0", "omega_1", "omega_2", "omega_3")
FULL = (*(f"f_dc_{i}" for i in range(6)), "f_t_0", "f_t_1", "f_t_2")
LITE = ("f_dc_0", "f_dc_1", "f_dc_2")
DECODER = {"w1": ("mlp1.weight", (6, 12, 1, 1)), "w2": ("mlp2.weight", (3, 6, 1, 1))}
ACTIVATIONS = {"sandwich": "sigmoid", "sandwichnoact": "clamp", "sandwichnoactss": "none"}
"""STG's `rgbfunction`."""
FRAMES = 50
"""STG trains one model on so many frames, unless cfg_args says otherwise."""


class SpacetimeGaussians(Format):
    """The PLY of Spacetime Gaussians, full and lite, and its decoder."""

    name = "Spacetime Gaussians PLY"
    extensions = reads = (".ply",)
    keeps_cameras = True

    def sniff(self, head: bytes, path: Path) -> bool:
        names = ply.read_header(path).names if head.startswith(b"ply") else frozenset()
        return not names.isdisjoint(("trbf_center", "trbf_scale", "omega_0")) and not is_dynamic(names)

    def load(self, path: Path) -> GaussianModel:
        header = ply.read_header(path)
        kinds = from_comments(header.comments, KEYS)
        recorded = kinds.pop("appearance", None)
        settings = {} if "clip" in kinds else _settings(path)
        basis, powers, constant = _motion_columns(header, kinds.pop("basis", None))
        full = not header.names.isdisjoint(FULL[3:])
        if full and not header.names.issuperset(FULL):
            raise FastGSError("it has some but not all of the columns f_dc_0..5 and f_t_0..2; export it again.")
        appearance: Appearance = RGB()
        if full:
            ours = isinstance(recorded, Features)
            ending = (recorded.activation, recorded.decode) if ours else (_activation(path, settings), "premultiplied")
            appearance = _read_decoder(path.with_suffix(".pt"), *ending)
        arrays = ply.read_vertices(path, header, {
            "position": POSITION, "rotation": ROTATION, "scale": SCALE, "opacity": "opacity", "features": FULL if full else LITE,
            "motion": powers, "constant": constant, "rotation_motion": OMEGA, "mu_tau": "trbf_center", "temporal": ("trbf_scale",)})
        shift = arrays.pop("constant")
        with np.errstate(over="ignore", invalid="ignore"):
            if shift.size:
                arrays["position"] += shift
            arrays["temporal"] *= -2
        arrays["motion"] = arrays["motion"].reshape(len(shift), len(powers) // 3, 3)
        arrays["rotation_motion"] = arrays["rotation_motion"][:, None]
        kinds = {"clip": Clip(settings.get("frames", FRAMES)), "basis": basis, "appearance": appearance} | kinds
        return GaussianModel(**restored(arrays, kinds))

    def fit(self, model: GaussianModel) -> tuple[GaussianModel, list[str]]:
        lost = comments(model, KEYS)[1]
        steps = [bell_opacity, polynomial_motion, linear_rotation, lambda m: plain_colour(m, keep_features=True)]
        if isinstance(model.basis, (Fourier, Cosine)):
            steps.remove(polynomial_motion)
        if isinstance(model.appearance, Features) and model.appearance.decode != "premultiplied":
            lost = [*lost, "Spacetime Gaussians' own renderer does not divide features by alpha: half-transparent parts differ there"]
        for step in steps:
            model, clauses = step(model)
            lost += clauses
        return model, lost

    def files(self, model: GaussianModel, path: Path) -> list[Path]:
        if not isinstance(model.appearance, Features):
            return [path]
        decoder = path.with_suffix(".pt")
        if decoder.exists():
            try:
                _read_decoder(decoder, "sigmoid", "premultiplied")
            except (FastGSError, OSError) as error:
                raise FastGSError(f"the decoder would replace {decoder.name}, which is something else; choose another name.") from error
        return [decoder, path]

    def write(self, model: GaussianModel, targets: list[Path]) -> None:
        appearance = model.appearance
        full = isinstance(appearance, Features)
        if isinstance(appearance, Features):
            weights = {"w1": appearance.w1, "w2": appearance.w2}
            torch_zip.write(targets[0], {name: weights[key].reshape(shape) for key, (name, shape) in DECODER.items()})
        n = len(model)
        if isinstance(model.basis, Fourier):
            motion = model.motion.transpose(0, 2, 1).reshape(n, 3 * model.basis.terms)
        elif isinstance(model.basis, Cosine):
            pairs = np.stack([np.zeros_like(model.motion), model.motion], 2)  # [N, K, sin and cos, 3]
            motion = pairs.transpose(0, 3, 1, 2).reshape(n, 6 * model.basis.terms)
        else:
            motion = np.zeros((n, 9), np.float32)
            motion[:, :3 * model.basis.terms] = model.motion.reshape(n, 3 * model.basis.terms)
        omega = model.rotation_motion[:, 0] if model.rotation_basis.terms else np.zeros((n, 4), np.float32)
        width = -0.5 * model.temporal if isinstance(model.temporal_kind, Radial) else np.full((n, 1), STEEP / 2, np.float32)
        ply.write(targets[-1], [f"Written by {generator()}", *comments(model, KEYS)[0]], [
            (POSITION, model.position), (("trbf_center",), model.mu_tau[:, None]), (("trbf_scale",), width),
            (NORMAL, np.broadcast_to(np.float32(0), (n, 3))), ([f"motion_{i}" for i in range(motion.shape[1])], motion),
            (FULL[:6] if full else LITE, model.features[:, :6]),
            (("opacity",), model.opacity[:, None]), (SCALE, model.scale), (ROTATION, model.rotation), (OMEGA, omega),
            *([(FULL[6:], model.features[:, 6:])] if full else [])])


def _motion_columns(header: ply.Header, recorded: Basis | None) -> tuple[Basis, list[str], list[str]]:
    """The basis, the columns' names in the order of GaussianModel.motion, and those of the constant term, if any."""
    count = sum(name.startswith("motion_") for name in header.names)
    if not header.names.issuperset(f"motion_{i}" for i in range(count)):
        raise FastGSError("its columns motion_* are not numbered from 0 on; export it again.")
    width, rest = divmod(count, 3)
    if isinstance(recorded, Cosine) and count == 6 * recorded.order:
        return recorded, [f"motion_{axis * width + 2 * k + 1}" for k in range(recorded.order) for axis in range(3)], []
    fourier = recorded if isinstance(recorded, Fourier) else Fourier(width // 2)
    if count == 9 and not isinstance(recorded, Fourier):
        return recorded or Polynomial(3), [f"motion_{i}" for i in range(9)], []
    if rest or (recorded is None and width < 2) or recorded not in (None, fourier) or width - fourier.terms not in (0, 1):
        raise FastGSError(f"its {count} columns motion_* fit neither a cubic (9) nor {'its' if recorded else 'a'} Fourier series; "
                          "export it again.")
    first = width - fourier.terms
    columns = [f"motion_{axis * width + k}" for k in range(first, width) for axis in range(3)]
    return fourier, columns, [f"motion_{axis * width}" for axis in range(3)] if first else []


def _activation(path: Path, settings: dict) -> str:
    """The decoder's output activation; warns about an unknown one, and where nothing says which it is."""
    function = settings.get("function")
    if isinstance(function, str) and function in ACTIVATIONS:
        return ACTIVATIONS[function]
    told = "no cfg_args beside it says how its decoder ends" if function is None else f"its decoder's end {shown(function)} is unknown"
    warnings.warn(LossWarning(f"{path}: {told}, so sigmoid is used. Models of Technicolor need their cfg_args."), stacklevel=5)
    return "sigmoid"


def _settings(path: Path) -> dict:
    """frames and function, so far as a cfg_args near the file has them; a broken one is skipped with a warning."""
    file = cfg_args.find(path)
    if file is None:
        return {}
    try:
        said, settings = cfg_args.read(file), {}
        if "duration" in said:
            settings["frames"] = said["duration"]
            if type(said["duration"]) is not int or not 1 <= said["duration"] <= 10_000_000:
                raise FastGSError(f"{file} says a duration of {shown(said['duration'])}")
        settings["function"] = said.get("rgbfunction")
    except FastGSError as error:
        warnings.warn(LossWarning(f"{error}; {path.name} is taken to have {FRAMES} frames and the decoder of N3V."), stacklevel=5)
        return {"function": "sandwich"}
    return settings


def _read_decoder(path: Path, activation: str, decode: str) -> Features:
    """The decoder in a .pt file; raises FastGSError."""
    if not path.exists():
        raise FastGSError(f"its decoder {path.name} is missing; put it beside the model.")
    try:
        with reading(path):
            content = torch_zip.TorchFile(path).content
            weights = {}
            for key, (name, shape) in DECODER.items():
                tensor = content.get(name) if isinstance(content, dict) else None
                if not isinstance(tensor, torch_zip.Tensor) or tensor.shape not in (shape, shape[:2]):
                    raise FastGSError(f"it has no {name} of {shape[0]} x {shape[1]} numbers.")
                with np.errstate(over="ignore", invalid="ignore"):
                    weights[key] = tensor.read().astype(np.float32).reshape(shape[:2])
            return Features(**weights, activation=activation, decode=decode)
    except FastGSError as error:
        reason = str(error).removeprefix(printable(f"{path}: "))
        raise FastGSError(f"its decoder {path.name} cannot be used: {reason}") from error
