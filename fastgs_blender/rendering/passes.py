# SPDX-License-Identifier: GPL-3.0-or-later
"""The render passes: one table of what each is called, how it is computed, and how files and Blender name it.

A new pass is one entry of PASSES.  render(), `fastgs render`, the EXR writer and Blender's passes all read this table.
"""
from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from ..cameras.camera import Camera
from ..util.arguments import one_of
from ..util.errors import FastGSError
from ..util.threads import ranges, run
from . import cryptomatte, false_colour
from .colour import PIXELS
from .instances import Moment, ViewedInstance
from .normals import normal
from .quantities import Mist, Quantity, vector
from .relight import SceneLight
from .shading import contact_occlusion, lamp_light, lamp_share, unlit
from .shadow import Shadow

FAR = np.float32(1e10)
"""Depth where there is nothing, in files and in Blender, as Blender's own engines write it: filters turn an infinity into NaN."""
SORTINGS = ("centre", "pixel")
FILMS = ("opaque", "transparent")
LAMPS = 8
"""Lights whose shadows can be had, each in a pass of its own."""
LEVELS = 8
"""Levels of Cryptomatte that can be had: as many as Blender's most, 16 objects a pixel, needs."""


@dataclass(frozen=True)
class PassSettings:
    """The settings of a scene that passes depend on, besides the models and the camera.

    mist           the distances of the Mist pass
    before, after  the scene one frame earlier and later, for the Vector pass; see quantities.vector
    shadows        the lights and the meshes of the passes of shadows, one for each, at most LAMPS; see shadow.py
    light          what lights the splats, see relight.py; None: their colours are as captured
    sorting        "centre": all splats by the depth of their centres; "pixel": in each pixel by the depth of the greatest density on its
                   ray, so that none comes suddenly before another while the camera turns (StopThePop, Radl et al. 2024)
    film           "opaque": nothing is put behind the picture, so a model of Spacetime Gaussians shows what its decoder makes of no
                   features there; "transparent": that is left out, and alpha says what can be put behind.  Other models are the same

    Raises FastGSError for another sorting or film, and for too many shadows.

    Example:
        picture = fg.render(model, camera, settings=fg.PassSettings(sorting="pixel"))
    """

    mist: Mist = field(default_factory=Mist)
    before: Moment | None = None
    after: Moment | None = None
    shadows: tuple[Shadow, ...] = ()
    light: SceneLight | None = None
    sorting: str = "centre"
    film: str = "opaque"

    def __post_init__(self) -> None:
        one_of(self.sorting, "how splats are sorted", SORTINGS)
        one_of(self.film, "the film", FILMS)
        if len(self.shadows) > LAMPS:
            raise FastGSError(f"{len(self.shadows)} lights cast shadows; at most {LAMPS} can.")

    @property
    def by_pixel(self) -> bool:
        """Whether each pixel sorts its splats for itself."""
        return self.sorting == "pixel"

    def quantities(self, names: Iterable[str], instances: list[ViewedInstance], backend: Any) -> dict[str, Quantity]:
        """Those quantities, of all that passes may need, whose names are given; backend: a loaded one (util/backends.py)."""
        table = {
            "mist": self.mist.quantity, "normal": lambda: normal(instances, backend),
            "vector": lambda: vector(instances, self.before, self.after),
            "unlit": lambda: unlit(instances, backend), "contact": contact_occlusion,
        }
        for level in range(LAMPS):
            table |= {LIGHTS[level].name: partial(lamp_light, level), MESH_SHADOWS[level].name: partial(lamp_share, level, "meshes"),
                      LAMP_SHADOWS[level].name: partial(lamp_share, level, "both")}
        return {name: make() for name, make in table.items() if name in names}


DEFAULTS = PassSettings()


@dataclass(frozen=True, eq=False)
class Blended:
    """The blended sums from which a picture's passes are computed, NumPy arrays of the window.

    camera   whose picture it is
    rgb      [h, w, 3]  premultiplied colour; None where no pass needs it
    alpha    [h, w]
    sums     [h, w, K]  by name, the plane's and the quantities' sums over the splats, times their weights (quantities.py)
    probes   [h, w]     by name (layout.PROBES)
    objects  (name, index) of each object in the picture
    shares   [h, w, K]  what part of each pixel each of the objects covers; None where no pass needs it
    held     [h, w]     the light that a holdout stops; None without one
    shadows  [h, w]     by the pass's name, the share of a light that splats let through to meshes
    """

    camera: Camera
    rgb: Any
    alpha: np.ndarray
    sums: dict[str, np.ndarray]
    probes: dict[str, np.ndarray]
    objects: list[tuple[str, int]]
    shares: Any
    held: np.ndarray | None = None
    shadows: dict[str, np.ndarray] = field(default_factory=dict)

    def rows(self, first: int, last: int) -> Blended:
        """Those of the window's rows first..last."""
        x0, y0, width, _ = self.camera.window

        def cut(array: Any) -> Any:
            return None if array is None else array[first:last]

        sums, probes, shadows = ({name: cut(each) for name, each in arrays.items()} for arrays in (self.sums, self.probes, self.shadows))
        return replace(self, camera=replace(self.camera, window=(x0, y0 + first, width, last - first)), rgb=cut(self.rgb),
                       alpha=cut(self.alpha), sums=sums, probes=probes, shares=cut(self.shares), held=cut(self.held), shadows=shadows)

    def at_pixels(self, sums: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """The mean of a quantity that is a plane, a + b x + c y with x and y from the image's middle, at the pixels [h, w, K / 3].

        sums [h, w, K] a, b and c times the splats' weights; weight [h, w] the sum of these.  Where it is 0 the mean is 0.
        """
        weight = weight[..., None]
        mean = np.divide(sums, weight, out=np.zeros_like(sums), where=weight > 0)
        (a, b, c), (x, y) = np.split(mean, 3, -1), (side.astype(np.float32) for side in self.camera.from_middle())
        return a + b * x[:, None] + c * y[:, None, None]


@dataclass(frozen=True)
class Pass:
    """One render pass.

    name      what render() calls it
    image     (Blended) -> [h, w] or [h, w, channels]
    needs     what `image` reads of Blended, alpha apart: "rgb", "shares", names of sums and of probes
    channels  1, or how many the last axis has
    empty     its value where nothing is drawn
    colour    whether it is a colour, which files and Blender get in scene-linear light
    exr       the names of its channels in an EXR file; "Layer.X" is the layer `Layer` in Blender's compositor
    blender   the pass of Blender that it fills.  Combined is filled by rgb and alpha together; of two that fill one pass,
              the scene's settings choose
    letters, kind   channels and type of that pass as Blender's API wants them; not the one channel A, beyond which Blender 5.3's File
                    Output node writes
    switch    the property of Blender's view layer that switches it on: one of Blender's own, or with the prefix "fastgs." one of
              the extension's, which is made from this table
    description   what that switch of the extension's says to users
    exposed   whether it is an average over the exposure; the others show the middle of its time, through the middle of the lens: averages
              of depths or directions would be those of nothing
    mixes     whether values of neighbouring pixels may be mixed
    title     what panels call it, if not as Blender names the pass
    meshes    whether it says something of the meshes of a scene: files of a model alone have none, unless they are asked for
    light     whether it shows what the scene's lamps do (PassSettings.light)
    level     of a pass that comes in levels, which one it is.  Blender's view layer says how many it wants, of shadows the number of
              lamps; files get the first three if nothing else is said
    display   (image) -> [h, w, 3]: what viewports show of a pass that is no colour, see false_colour.py
    shows     what these colours mean, for users
    """

    name: str
    image: Callable[[Blended], np.ndarray]
    needs: tuple[str, ...] = ()
    channels: int = 1
    empty: float = 0.0
    colour: bool = False
    exr: tuple[str, ...] = ()
    blender: str = ""
    letters: str = ""
    kind: str = "VALUE"
    switch: str = ""
    description: str = ""
    exposed: bool = False
    mixes: bool = False
    title: str = ""
    meshes: bool = False
    light: bool = False
    level: int = 0
    display: Callable[[np.ndarray], np.ndarray] = false_colour.grey
    shows: str = ""

    @property
    def builtin(self) -> bool:
        """Whether the switch for it is Blender's own."""
        return not self.switch.startswith("fastgs.")

    @property
    def standard(self) -> bool:
        """Whether Blender adds the pass to a picture by itself."""
        return self.builtin and not self.blender.startswith(cryptomatte.LAYER)

    def shown(self, image: np.ndarray) -> np.ndarray:
        """The image [h, w] or [h, w, channels] as files and Blender hold it: FAR in place of infinity."""
        return np.minimum(image, FAR) if self.empty == np.inf else image


def images(entries: Sequence[Pass], blended: Blended | None, camera: Camera) -> dict[str, np.ndarray]:
    """The images [h, w] or [h, w, channels] float32 of passes, by name; blended: None where nothing was drawn.

    What is not there yet is computed in bands of rows, on all threads, so that it stays in the processor's cache.
    """
    _, _, width, height = camera.window
    shapes = {each.name: (height, width) if each.channels == 1 else (height, width, each.channels) for each in entries}
    if blended is None:
        return {each.name: np.full(shapes[each.name], each.empty, np.float32) for each in entries}
    there = {"rgb": blended.rgb, "alpha": blended.alpha}
    out = {name: np.ascontiguousarray(there[name], np.float32) if name in there else np.empty(shape, np.float32)
           for name, shape in shapes.items()}
    made = [each for each in entries if each.name not in there]

    def band(first: int, last: int) -> None:
        part = blended.rows(first, last)
        for each in made:
            out[each.name][first:last] = each.image(part)

    if made:
        run(band, ranges(height, max(PIXELS // width, 1)))
    return out


def _expected_depth(blended: Blended) -> np.ndarray:
    return np.where(blended.alpha > 0, blended.at_pixels(blended.sums["plane"], blended.alpha)[..., 0], np.inf)


def _position(blended: Blended) -> np.ndarray:
    """The point at the expected depth on the ray of each pixel."""
    points = blended.camera.points(np.where(blended.alpha > 0, _expected_depth(blended), 0))
    return np.where(blended.alpha[..., None] > 0, points, 0)


def _mist(blended: Blended) -> np.ndarray:
    return blended.sums["mist"][..., 0] + (1 - blended.alpha)


def _normal(blended: Blended) -> np.ndarray:
    total = blended.sums["normal"]
    length = np.linalg.norm(total, axis=-1, keepdims=True)
    return np.divide(total, length, out=np.zeros_like(total), where=length > 0)


def _vector(blended: Blended) -> np.ndarray:
    sums = blended.sums["vector"]
    return blended.at_pixels(sums[..., :-1], sums[..., -1])


def _held(blended: Blended) -> np.ndarray:
    return np.zeros_like(blended.alpha) if blended.held is None else blended.held


def _object_index(blended: Blended) -> np.ndarray:
    """The index of what covers most of each pixel; that of nothing is 0."""
    numbers = np.unique([0, *(index for _, index in blended.objects)])
    cover = np.zeros((*blended.alpha.shape, len(numbers)), np.float32)
    cover[..., np.searchsorted(numbers, 0)] = 1 - blended.alpha
    for i, (_, index) in enumerate(blended.objects):
        cover[..., np.searchsorted(numbers, index)] += blended.shares[..., i]
    return numbers[cover.argmax(-1)]


def _cryptomatte(level: int) -> Pass:
    name = f"{cryptomatte.LAYER}{level:02d}"
    return Pass(f"cryptomatte_{level:02d}", lambda b: cryptomatte.level(b.shares, [name for name, _ in b.objects], level), ("shares",), 4,
                exr=tuple(f"{name}.{letter}" for letter in "rgba"), blender=name, letters="rgba", kind="COLOR",
                switch="use_pass_cryptomatte_object", title="Cryptomatte Object", level=level, exposed=True,
                display=false_colour.mattes, shows="A colour for each object, as bright as it covers the pixel")


def _shadow(level: int) -> Pass:
    number = f" {level + 1}" if level else ""
    name = "shadow" + number.replace(" ", "_")
    return Pass(name, lambda b: b.shadows.get(name, np.ones_like(b.alpha)), (name,), empty=1.0, mixes=True, meshes=True,
                exr=(f"Splat Shadow{number}.X",), blender=f"Splat Shadow{number}", letters="X", switch="fastgs.use_pass_shadow",
                title="Splat Shadow", level=level,
                description="Deliver how much of each lamp's light splats let through to the meshes that the camera sees: a factor on it",
                shows="Black where splats keep all of the light from meshes, white where they let all of it through")


def _mean(blended: Blended, name: str, without: float) -> np.ndarray:
    """The mean over the splats of a pixel of a quantity [h, w, channels], and a value where there are none."""
    total, alpha = blended.sums[name], blended.alpha[..., None]
    return np.divide(total, alpha, out=np.full_like(total, without), where=alpha > 0)


def _share(title: str, level: int, of: str) -> Pass:
    number = f" {level + 1}" if level else ""
    name, switch = (title + number).lower().replace(" ", "_"), f"fastgs.use_pass_{title.lower().replace(' ', '_')}"
    return Pass(name, lambda b: _mean(b, name, 1.0)[..., 0], (name,), empty=1.0, mixes=True, meshes=True, light=True,
                exr=(f"{title}{number}.X",), blender=title + number, letters="X", switch=switch, title=title, level=level,
                description=f"Deliver how much of each lamp's light {of} let through to the splats: a factor on Lamp Light",
                shows=f"Black where {of} keep all of the light from splats, white where they let all of it through")


def _lamp_light(level: int) -> Pass:
    number = f" {level + 1}" if level else ""
    name = "lamp_light" + number.replace(" ", "_")
    return Pass(name, lambda b: _mean(b, name, 0.0), (name,), 3, mixes=True, meshes=True, light=True,
                exr=tuple(f"Lamp Light{number}.{letter}" for letter in "RGB"), blender=f"Lamp Light{number}", letters="RGB", kind="COLOR",
                switch="fastgs.use_pass_lamp_light", title="Lamp Light", level=level, display=partial(np.clip, a_min=0, a_max=1),
                description="Deliver the light of each lamp, and of the world, on the splats as if these were white and nothing in its way",
                shows="The light as it is on white paint")


SHADOWS = tuple(_shadow(level) for level in range(LAMPS))
"""The passes of shadows, in the order of PassSettings.shadows."""
MESH_SHADOWS = tuple(_share("Mesh Shadow", level, "meshes") for level in range(LAMPS))
LAMP_SHADOWS = tuple(_share("Lamp Shadow", level, "meshes and splats") for level in range(LAMPS))
LIGHTS = tuple(_lamp_light(level) for level in range(LAMPS))
"""The passes of the lamps that light splats, by the levels of SceneLight."""

PASSES = {entry.name: entry for entry in (
    Pass("rgb", lambda b: b.rgb, ("rgb",), 3, colour=True, exposed=True, mixes=True, exr=("R", "G", "B"),
         blender="Combined", letters="RGBA", kind="COLOR", switch="use_pass_combined"),
    # not "Alpha": that is what the compositor calls Combined's fourth channel, and a pass of this name takes its socket away
    Pass("alpha", lambda b: b.alpha, exposed=True, mixes=True, exr=("A",), blender="Splat Alpha", letters="X",
         switch="fastgs.use_pass_alpha",
         description="Deliver the opacity of the splats, which the world does not fill up",
         shows="White is opaque, black is empty"),
    Pass("holdout", _held, exposed=True, mixes=True, meshes=True, exr=("Splat Holdout.X",), blender="Splat Holdout", letters="X",
         switch="fastgs.use_pass_holdout",
         description="Deliver the light that meshes stop which hide splats: how much of a pixel their own picture is to fill",
         shows="White where meshes stop all light, black where they stop none"),
    *SHADOWS, *LIGHTS, *MESH_SHADOWS, *LAMP_SHADOWS,
    Pass("contact", lambda b: _mean(b, "contact", 1.0)[..., 0], ("contact",), empty=1.0, mixes=True, meshes=True, light=True,
         exr=("Contact Occlusion.X",), blender="Contact Occlusion", letters="X", switch="fastgs.use_pass_contact",
         description="Deliver how much of the light from all around meshes nearby leave to the splats: a factor, dark where they touch",
         shows="White where no mesh is near, dark where one touches the splats"),
    Pass("unlit", lambda b: b.sums["unlit"], ("unlit",), 3, colour=True, mixes=True,
         exr=tuple(f"Unlit Colour.{letter}" for letter in "RGB"), blender="Unlit Colour", letters="RGB", kind="COLOR",
         switch="fastgs.use_pass_unlit",
         description="Deliver an estimate of the splats' colours without the smooth part of the light that they were captured in"),
    Pass("depth", _expected_depth, ("plane",), empty=np.inf, exr=("Depth.Z",), blender="Depth", letters="Z", switch="use_pass_z",
         display=false_colour.near_to_far, shows="Near is bright, far is dark"),
    Pass("median_depth", lambda b: b.probes["median"], ("median",), empty=np.inf, exr=("MedianDepth.Z",), blender="Depth", letters="Z",
         switch="use_pass_z", display=false_colour.near_to_far, shows="Near is bright, far is dark"),
    Pass("first_depth", lambda b: b.probes["first"], ("first",), empty=np.inf, exr=("FirstDepth.Z",), blender="Depth", letters="Z",
         switch="use_pass_z", display=false_colour.near_to_far, shows="Near is bright, far is dark"),
    Pass("mist", _mist, ("mist",), empty=1.0, mixes=True, exr=("Mist.Z",), blender="Mist", letters="Z", switch="use_pass_mist",
         shows="Black near, white far"),
    Pass("position", _position, ("plane",), 3, exr=("Position.X", "Position.Y", "Position.Z"),
         blender="Position", letters="XYZ", kind="VECTOR", switch="use_pass_position", display=false_colour.places,
         shows="Red, green and blue grow with x, y and z, over what is seen"),
    Pass("normal", _normal, ("normal",), 3, mixes=True, exr=("Normal.X", "Normal.Y", "Normal.Z"),
         blender="Normal", letters="XYZ", kind="VECTOR", switch="use_pass_normal", display=false_colour.directions,
         shows="Red, green and blue are x, y and z; -1 is dark, 1 is bright"),
    Pass("vector", _vector, ("vector",), 4, exr=("Vector.X", "Vector.Y", "Vector.Z", "Vector.W"),
         blender="Vector", letters="XYZW", kind="VECTOR", switch="use_pass_vector", display=false_colour.motion,
         shows="The hue is the direction of motion to the next frame, the brightness its speed"),
    Pass("object_index", _object_index, ("shares",), exr=("Object Index.X",), blender="Object Index", letters="X",
         switch="use_pass_object_index", display=false_colour.numbered, shows="A colour for each Pass Index; 0 is black"),
    *(_cryptomatte(level) for level in range(LEVELS)),
    Pass("count", lambda b: b.probes["count"], ("count",), mixes=True, exr=("Gaussian Count.X",), blender="Gaussian Count", letters="X",
         display=false_colour.heat, switch="fastgs.use_pass_count",
         description="Deliver how many Gaussians were blended into each pixel, to see what a frame costs",
         shows="Black is none, nearly white the most of the picture"),
)}
"""The passes by name."""
