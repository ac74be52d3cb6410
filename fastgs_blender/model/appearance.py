# SPDX-License-Identifier: GPL-3.0-or-later
"""The appearance of Gaussians: RGB, spherical harmonics, or features that a small decoder turns into colour.

A model holds one array `features` [N, F]; its appearance says what the columns mean.  A new one is a dataclass here, listed in
APPEARANCES; each backend computes its colour: rendering/oracle.py, kernels/.
"""
from dataclasses import dataclass, field
from numbers import Integral
from typing import ClassVar

import numpy as np

from ..util.arguments import numbers, one_of
from ..util.errors import FastGSError
from .basis import Basis
from .motion import Static

SH_C0 = 0.28209479177387814
SH_C1 = 0.4886025119029199
SH_C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
SH_C3 = (-0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154, -0.4570457994644658, 1.445305721320277,
         -0.5900435899266435)
SH_C4 = (2.5033429417967046, -1.7701307697799304, 0.9461746957575601, -0.6690465435572892, 0.10578554691520431, -0.6690465435572892,
         0.47308734787878004, -1.7701307697799304, 0.6258357354491761)
"""Factors of the spherical harmonics of each degree, in the order of sh_basis.  Shaders take them from here."""
ACTIVATIONS = ("sigmoid", "clamp", "none")
"""Output activations of STG's decoder: N3V, Technicolor, Immersive (`sandwich`, `sandwichnoact`, `sandwichnoactss`)."""
DECODES = ("normalised", "premultiplied")
"""What a decoder is given: the mean of the features that cover a pixel, or their sum as blending leaves it (STG)."""


class Appearance:
    """What every appearance answers.

    name, width    as files name it; F, the number of columns
    code           how kernels and shaders know it
    recorded       the fields that a file records of it, beside arrays
    optional       those of them that a file may lack; they have their default then
    unit           how much colour is added where its first three columns are 1 greater
    """

    name: ClassVar[str] = ""
    code: ClassVar[int]
    width: ClassVar[int]
    degree: int  # of those with harmonics
    recorded: ClassVar[tuple[str, ...]] = ()
    optional: ClassVar[tuple[str, ...]] = ()
    unit: ClassVar[float] = 1.0

    def features_of(self, rgb: np.ndarray) -> np.ndarray:
        """Features [N, F] that show the display colours rgb [N, 3] from everywhere and at all times."""
        features = np.zeros((len(rgb), self.width))
        features[:, :3] = rgb
        return features

    def plain_colours(self, features: np.ndarray) -> np.ndarray:
        """Colours [N, 3] of features [N, F], seen from no particular side."""
        return features[:, :3]

    def seen(self, features: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """What is blended of features [N, F] that are seen along unit directions [N, 3]: colours [N, 3], or features for a decoder."""
        return features


@dataclass(frozen=True)
class RGB(Appearance):
    """Columns: r, g, b as they are (STG lite).

    Example:
        look = fg.RGB()
    """

    name: ClassVar[str] = "rgb"
    code: ClassVar[int] = 0
    width: ClassVar[int] = 3


@dataclass(frozen=True)
class SH(Appearance):
    """Real spherical harmonics: max(0, 0.5 + sum_b Y_b(direction) c_b).

    Columns: B = (degree + 1)^2 coefficients, each r, g, b; so features.reshape(N, B, 3)[:, 0] is INRIA's f_dc.

    Example:
        look = fg.SH(3)
    """

    name: ClassVar[str] = "sh"
    code: ClassVar[int] = 1
    recorded: ClassVar[tuple[str, ...]] = ("degree",)
    unit: ClassVar[float] = SH_C0
    degree: int = 0

    def __post_init__(self) -> None:
        if isinstance(self.degree, bool) or not isinstance(self.degree, Integral) or not 0 <= self.degree <= 4:
            raise FastGSError(f"spherical harmonics of degree 0 to 4 are supported, not {self.degree!r}.")

    @property
    def width(self) -> int:  # type: ignore[override]
        return 3 * (self.degree + 1) ** 2

    def features_of(self, rgb: np.ndarray) -> np.ndarray:
        return super().features_of((rgb - 0.5) / SH_C0)

    def plain_colours(self, features: np.ndarray) -> np.ndarray:
        """Colours [N, 3] of features [N, F]: the mean over all directions."""
        return 0.5 + SH_C0 * features[:, :3]

    def seen(self, features: np.ndarray, directions: np.ndarray) -> np.ndarray:
        basis = sh_basis(directions, self.degree)
        return np.maximum(0, 0.5 + np.einsum("mb,mbc->mc", basis, features.reshape(*basis.shape, 3)))


@dataclass(frozen=True, eq=False)
class Features(Appearance):
    """STG full and FAST-GS.  Columns: base (3), direction (3), time (3, multiplied by t - mu_tau).

    Per pixel, from features f and the ray (camera centre, unit direction; both in the model's space):
    decode(f) = activation(base + w2 @ relu(w1 @ [direction, time, ray])), w1 [6, 12], w2 [3, 6], no biases.

    With the blended sum F of the features and its weight alpha, `decode` says what a pixel shows:
    normalised     alpha decode(F / alpha): a surface has one colour, however much of the pixel it covers
    premultiplied  decode(F), as STG's renderer does.  Its picture is opaque: where nothing is, it is decode(0).
                   Over something else it is max(0, decode(F) - (1 - alpha) decode(0)), at most alpha; see lifted()

    Example:
        look = fg.Features(w1=np.zeros((6, 12)), w2=np.zeros((3, 6)))
    """

    name: ClassVar[str] = "features"
    code: ClassVar[int] = 2
    width: ClassVar[int] = 9
    recorded: ClassVar[tuple[str, ...]] = ("activation", "decode")
    optional: ClassVar[tuple[str, ...]] = ("decode",)
    w1: np.ndarray = field(default_factory=lambda: np.zeros((6, 12), np.float32))
    w2: np.ndarray = field(default_factory=lambda: np.zeros((3, 6), np.float32))
    activation: str = "sigmoid"
    decode: str = "normalised"

    def __post_init__(self) -> None:
        for key, shape in (("w1", (6, 12)), ("w2", (3, 6))):
            value = np.ascontiguousarray(numbers(getattr(self, key), f"the decoder's {key}", f"{shape}", np.float32))
            if value.shape != shape or not np.isfinite(value).all():
                raise FastGSError(f"the decoder's {key} must be {shape[0]} x {shape[1]} finite numbers.")
            object.__setattr__(self, key, value)
        one_of(self.activation, "the decoder's activation", ACTIVATIONS)
        one_of(self.decode, "what the decoder is given", DECODES)

    def features_of(self, rgb: np.ndarray) -> np.ndarray:
        """Features [N, 9] of colours rgb [N, 3], as base and direction: the first shows them as long as w2 is 0, the second gives the
        decoder a start."""
        features = super().features_of(rgb)
        features[:, 3:6] = rgb
        if self.activation == "sigmoid":
            inside = np.clip(rgb, 0.01, 0.99)
            features[:, :3] = np.log(inside / (1 - inside))
        return features

    def plain_colours(self, features: np.ndarray) -> np.ndarray:
        """Colours [N, 3] of features [N, 9]: the base, without what the decoder adds."""
        return self.activated(features[:, :3])

    def activated(self, rgb: np.ndarray) -> np.ndarray:
        """The output activation [..., 3] of colours rgb [..., 3]."""
        if self.activation == "sigmoid":
            return 0.5 * (1 + np.tanh(0.5 * rgb))  # the same function, and it cannot overflow
        return np.clip(rgb, 0, 1) if self.activation == "clamp" else rgb


@dataclass(frozen=True)
class Changing(Appearance):
    """Plain colour or spherical harmonics whose columns change in time: f(t) = f_0 + sum_k w_k(t) f_k.

    Columns: those of `look` for f_0, then for each coefficient f_k of `basis`.  At one time it is `look`: momentary(), features_at().

    Example:
        look = fg.Changing(fg.SH(1), fg.Fourier(2))
    """

    name: ClassVar[str] = "changing"
    look: RGB | SH = field(default_factory=RGB)
    basis: Basis = field(default_factory=Static)

    def __post_init__(self) -> None:
        if not isinstance(self.look, (RGB, SH)) or not isinstance(self.basis, Basis):
            raise FastGSError(f"colours that change in time need RGB or SH and a basis of time, not {self.look!r} and {self.basis!r}.")

    @property
    def width(self) -> int:  # type: ignore[override]
        return self.look.width * (1 + self.basis.terms)

    def features_of(self, rgb: np.ndarray) -> np.ndarray:
        features = np.zeros((len(rgb), self.width))
        features[:, :self.look.width] = self.look.features_of(rgb)
        return features

    def plain_colours(self, features: np.ndarray) -> np.ndarray:
        """Colours [N, 3] of its look, from features [N, F] at one time or from constant terms."""
        return self.look.plain_colours(features[:, :self.look.width])


APPEARANCES = {cls.name: cls for cls in (RGB, SH, Features, Changing)}


def momentary(appearance: Appearance) -> RGB | SH | Features:
    """The appearance of a model at one time: that of the features which features_at() gives."""
    return appearance.look if isinstance(appearance, Changing) else appearance  # type: ignore[return-value]


def features_at(appearance: Appearance, features: np.ndarray, t: float, mu_tau: np.ndarray) -> np.ndarray:
    """Features [N, momentary F] float64 at time t, of a model's features [N, F] and temporal centres [N].

    Those of an appearance that does not change are as they are; the decoder's time features are not yet multiplied by t - mu_tau.
    """
    features = np.asarray(features, np.float64)
    if not isinstance(appearance, Changing):
        return features
    width = appearance.look.width
    coefficients = features[:, width:].reshape(len(features), appearance.basis.terms, width)
    return features[:, :width] + appearance.basis.value(coefficients, t, mu_tau)


def sh_basis(direction: np.ndarray, degree: int) -> np.ndarray:
    """Real spherical harmonics Y_b [..., (degree + 1)^2] of unit directions [..., 3], in 3DGS's order and signs.

    Bands l = 0..4, within a band m = -l..l, with the Condon-Shortley signs of Sloan 2013 as 3DGS uses them.
    """
    x, y, z = np.moveaxis(np.asarray(direction), -1, 0)
    out = [np.full_like(x, SH_C0)]
    if degree > 0:
        out += [-SH_C1 * y, SH_C1 * z, -SH_C1 * x]
    if degree > 1:
        xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
        a, b, c, d, e = SH_C2
        out += [a * xy, b * yz, c * (2 * zz - xx - yy), d * xz, e * (xx - yy)]
    if degree > 2:
        a, b, c, d, e, f, g = SH_C3
        out += [a * y * (3 * xx - yy), b * xy * z, c * y * (4 * zz - xx - yy), d * z * (2 * zz - 3 * xx - 3 * yy),
                e * x * (4 * zz - xx - yy), f * z * (xx - yy), g * x * (xx - 3 * yy)]
    if degree > 3:
        a, b, c, d, e, f, g, h, i = SH_C4
        out += [a * xy * (xx - yy), b * yz * (3 * xx - yy), c * xy * (7 * zz - 1), d * yz * (7 * zz - 3), e * (zz * (35 * zz - 30) + 3),
                f * xz * (7 * zz - 3), g * (xx - yy) * (7 * zz - 1), h * xz * (xx - 3 * yy),
                i * (xx * (xx - 3 * yy) - yy * (3 * xx - yy))]
    return np.stack(out, -1)


def decode(features: np.ndarray, centre: np.ndarray, ray: np.ndarray, appearance: Features) -> np.ndarray:
    """Colour [..., 3] of blended features [..., 9]; camera centre [3] or [..., 3], unit rays [..., 3]."""
    f = np.asarray(features)
    inputs = np.concatenate([f[..., 3:], np.broadcast_to(centre, f.shape[:-1] + (3,)), ray], -1)
    hidden = np.maximum(inputs @ appearance.w1.T.astype(f.dtype), 0)
    rgb = f[..., :3] + hidden @ appearance.w2.T.astype(f.dtype)
    return appearance.activated(rgb)


def lifted(whole: np.ndarray, empty: np.ndarray, weight: np.ndarray, appearance: Features) -> np.ndarray:
    """The picture of a decoder of premultiplied sums without what it shows behind them: premultiplied colour [..., 3].

    STG's picture is opaque, with the decoder's colour of no features at all behind the splats.  This is what lies before that, so that
    something else can be put behind.  Straight colours stay in the activation's range, which the difference may leave.

    whole   [..., 3] decode() of the blended sum, empty of zeros
    weight  [...] of the splats
    """
    share = weight[..., None]
    straight = np.divide(whole - (1 - share) * empty, share, out=np.zeros_like(whole), where=share > 0)
    return (straight if appearance.activation == "none" else np.clip(straight, 0, 1)) * share
