# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws a picture of splats on the GPU: blends them in the space in which their models were trained, then makes scene-linear colour of it.

Splats are blended once for each *group* that needs its own way from blended numbers to colour: one for all plain sRGB models,
one for all linear ones, one for each decoder, place and look.  In a group's turn the splats of others are black, so that they
hide what lies behind them.  Groups in one colour space are summed, then decoded; the spaces' light adds up (engine/scene_linear.py
does the same).  Nearly always there is one group.

Marks on the Gaussians of a model with a decoder (ObjectSettings.mark) are in its group.  Their share of each pixel is blended along, and
their look is mixed in when the decoder has made the colour.
"""
from dataclasses import dataclass, field

import gpu
import numpy as np

from ...fastgs_blender.cameras.camera import Camera
from ...fastgs_blender.kernels.gl.frame_table import Depths, ViewTexel, frame_table
from ...fastgs_blender.kernels.gl.resolve_table import resolve_table
from ...fastgs_blender.rendering.instances import ViewedInstance
from ...fastgs_blender.rendering.layout import decoding
from ...fastgs_blender.rendering.looks import Look
from ...scene.sky import Panorama
from . import shaders
from .atlas import Atlas
from .covering import covering_table
from .eye import WHOLE
from .textures import upload

FORMAT = 'RGBA16F'
HALF = 65_504
"""The largest number that half floats hold."""
SKY_WIDTH = 8192
"""The most pixels around of a panorama on the GPU."""


@dataclass(frozen=True)
class Group:
    """Instances whose blended numbers become colour in the same way (layout.decoding); `instance` is one with a decoder, or None.

    marks  the looks of those that mark Gaussians of a model with a decoder, by their marks
    """

    colour_space: str
    instance: ViewedInstance | None = None
    marks: dict[int, np.ndarray] = field(default_factory=dict, compare=False)


def grouped(instances: list[ViewedInstance]) -> tuple[list[Group], dict[int, int]]:
    """(the groups, {place of an instance in the list: place of its group})."""
    groups, member, known, marked = [], {}, {}, {}
    for number, instance in enumerate(instances):
        way, mark = (instance.model.colour_space, decoding(instance)), int(instance.look[Look.MARK])
        base = way[0], way[1] and way[1][:-1]  # whatever its look
        if mark and way[1] and base in marked:  # the object comes before its marks
            member[number] = marked[base]
            groups[marked[base]].marks[mark] = instance.look
            continue
        if way not in known:
            known[way] = len(groups)
            groups.append(Group(way[0], instance if way[1] else None))
        member[number] = known[way]
        if not mark:
            marked[base] = known[way]
    return groups, member


@dataclass(frozen=True, eq=False)
class SceneDepth:
    """The depth of what else is in the window, to hide splats behind: values [h, w], the bottom row first."""

    values: np.ndarray
    depths: Depths


class Order:
    """Which Gaussians to draw, the nearest first, on the GPU; see sorting.Sorted.order."""

    def __init__(self, rows: np.ndarray, count: int):
        self.count = count
        self.texture = upload(rows)


class Picture:
    """Targets of one size, and what was drawn into them last."""

    def __init__(self):
        self.size = None
        self.groups: list[Group] = []
        self.camera = None
        self.deep = False
        self._drawn = self._sky = self._shown = self._put = self._before = None
        self._targets = []
        self._no_depth = None

    @property
    def nbytes(self) -> int:
        """Bytes of the targets."""
        shown = 0 if self._shown is None else 8 * self._shown[0][1][0] * self._shown[0][1][1]
        return shown + sum(8 * self.size[0] * self.size[1] * len(textures) for textures, _ in self._targets)

    def draw(self, camera: Camera, instances: list[ViewedInstance], atlas: Atlas, order: Order, depth: SceneDepth | None = None,
             deep: bool = False, gone=frozenset()) -> None:
        """Blend the instances, whose models the atlas holds, in the given order, unless that is what the picture shows already.

        depth  hides splats behind it, each by itself
        deep   whether the picture's own depth is wanted: resolve() can then test it, and cover() can use it
        gone   places in `instances` of those of which nothing is to be drawn
        """
        self.camera = camera
        groups, member = grouped(instances)
        shape = (1, 1) if depth is None else depth.values.shape[::-1]
        table = frame_table(camera, instances, atlas.place, order.count, member, depth and depth.depths, shape, gone)
        same = (order, atlas.version, table.tobytes(), depth, deep)
        if same == self._drawn:
            return
        self._drawn = None
        self._resize((camera.width, camera.height), groups, deep)
        if self._no_depth is None:
            self._no_depth = upload(np.ones((1, 1, 1), np.float32))
        seen = self._no_depth if depth is None else upload(depth.values[..., None])
        with shaders.drawing('ALPHA_PREMULT'):
            for number, (_, framebuffer) in enumerate(self._targets):
                table[0, ViewTexel.DEPTHS, 3] = number
                with framebuffer.bind():
                    framebuffer.clear(color=(0.0, 0.0, 0.0, 0.0))
                    if order.count:
                        features, own = self._kind(number)
                        shader, batch = shaders.splats(features, own)
                        inputs = {"t_table": upload(table), "t_order": order.texture, "t_geometry": atlas.geometry,
                                  "t_colour": atlas.colour, "t_depth": seen}  # they must live until they are drawn
                        shaders.bind(shader, inputs)
                        batch.draw_instanced(shader, instance_count=order.count)
        self._drawn = same

    def resolve(self, working: np.ndarray, background=None, border=WHOLE, opacity: float = 1.0, frame=WHOLE,
                outside: float = 1.0, depths: Depths | None = None, share: float = 1.0) -> None:
        """Draw the picture over the whole of the active framebuffer: premultiplied, linear.

        working     [3, 3] from linear Rec.709 to the target's primaries
        background  colour or Panorama under the splats, or None
        border      the part of the framebuffer to draw: left, bottom, right, top, 0..1
        frame       where colours are as they are; elsewhere they are darkened, to the share `outside` of what they were
        depths      of the framebuffer: splats are hidden by what it holds, pixel by pixel, if the picture is deep; None: they are not
        share       of the picture in what is shown; the rest is what keep() kept
        """
        sky = isinstance(background, Panorama)
        if sky and (self._sky is None or self._sky[0] is not background):
            values = background.reduced(SKY_WIDTH)
            texels = np.concatenate([values, np.ones_like(values[..., :1])], -1)
            self._sky = background, upload(np.minimum(texels, HALF), half=True)
        elif not sky:
            self._sky = None
        window = tuple(gpu.state.viewport_get()[2:])
        eye = self.camera.world_to_camera.tobytes(), self.camera.fx, self.camera.fy, self.camera.cx, self.camera.cy
        wanted = self._drawn, window, background, sky and eye, working.tobytes(), border, opacity, frame, outside
        if self._shown is None or self._shown[0] != wanted:
            textures, framebuffer = self._shown[1:] if self._shown and self._shown[0][1] == window else _target(window, False, False)
            with framebuffer.bind():
                framebuffer.clear(color=(0.0, 0.0, 0.0, 0.0))
                self._finish(working, (0, 0, 0) if sky else background, border, opacity, frame, outside)
            self._shown = wanted, textures, framebuffer
        if share >= 1:
            self._before = None
        self._show(depths if self.groups else None, share)

    def keep(self) -> None:
        """Keep the picture that resolve() drew last, so that the next one can fade in over it."""
        self._before, self._shown, self._targets, self.size, self._drawn = self._put, None, [], None, None

    def _show(self, depths, share):
        """Put the finished picture into the active framebuffer."""
        new = self._shown[1]["t_first"]
        inputs = {"t_shown": new}
        if depths is not None:
            table = resolve_table(self.camera, self.size, Group("linear"), np.eye(3), depths=depths)
            inputs |= {"t_resolve": upload(table), "t_own": self._targets[0][0]["t_own"]}
        self._put, before = inputs, self._before
        if before is None or share <= 0:
            self._put_in(before or inputs)
            return
        old, later = (before | {"t_over": new}, 1 - share), (inputs | {"t_over": before["t_shown"]}, share)
        if "t_own" in before and "t_own" in inputs:
            old[0]["t_other"], later[0]["t_other"] = inputs["t_own"], before["t_own"]
            turns = [(*old, share), (*later, 1 - share, 1.0), (*old, 0.0), (*later, 0.0, 1.0)]
        else:  # what may be hidden comes first
            turns = [(*later, 1 - share), (*old, 0.0)] if "t_own" in inputs else [(*old, share), (*later, 0.0)]
        for turn in turns:
            self._put_in(*turn)

    def _put_in(self, inputs, share=1.0, rest=0.0, newer=0.0):
        """Put a share of a finished picture into the active framebuffer, tested by its depth where it has one.

        rest   the share of another picture, t_over, that is put in afterwards; 0: it is there already
        newer  with t_other, the depth of that one: 1 for the newer of both.  The farther one is put in first, pixel by pixel
        """
        deep, fading, ordered = (name in inputs for name in ("t_own", "t_over", "t_other"))
        shader, batch = shaders.show(deep, fading, ordered)
        with shaders.drawing('ALPHA_PREMULT', 'LESS_EQUAL' if deep else 'NONE'):
            shader.bind()
            if fading:
                shader.uniform_float("share", share)
                shader.uniform_float("rest", rest)
            if ordered:
                shader.uniform_float("newer", newer)
            shaders.fill(shader, batch, inputs)

    def _finish(self, *options):
        """Make scene-linear colour of all groups, in the active framebuffer; for the options see resolve()."""
        if not self.groups:  # the background alone
            self._resolve(Group("linear"), {"t_first": upload(np.zeros((1, 1, 4), np.float32))}, *options, size=(1, 1))
        elif len(self.groups) == 1:
            self._resolve(self.groups[0], self._targets[0][0], *options, own=self._kind(0)[1])
        else:
            for number, (space, textures) in enumerate(self._sums().items()):
                self._resolve(Group(space), textures, *options, first=number == 0, own=True, summed=True)

    def _sums(self):
        """For each colour space, the blended colours of its groups and their summed weight in the picture."""
        sums = {}
        for group, (textures, _) in zip(self.groups, self._targets):
            if group.colour_space not in sums:
                target, framebuffer = _target(self.size, False, False)
                sums[group.colour_space] = {**target, "t_own": textures["t_own"]}, framebuffer
                with framebuffer.bind():
                    framebuffer.clear(color=(0.0, 0.0, 0.0, 0.0))
            with sums[group.colour_space][1].bind():
                self._resolve(group, textures, np.eye(3), own=True, raw=True)
        return {space: textures for space, (textures, _) in sums.items()}

    def _resolve(self, group, textures, *options, first=True, own=False, summed=False, raw=False, size=None):
        sky = self._sky if first and not raw else None
        values = resolve_table(self.camera, size or self.size, group, *options, sky=sky and (sky[1].width, sky[1].height), first=first,
                               summed=summed, raw=raw)
        with shaders.drawing('ALPHA_PREMULT' if first and not raw else 'ADDITIVE_PREMULT'):
            shaders.fill(*shaders.resolve(group.instance is not None, own, sky is not None),
                  {"t_resolve": upload(values), **textures} | ({"t_sky": sky[1]} if sky else {}))

    def cover(self, depths: Depths, window: tuple[int, int], floor: bool, marks) -> None:
        """Take away from the active framebuffer, which holds overlays with their depth, what lies behind the splats of a deep picture.

        For the parameters see covering_table().
        """
        if not (self.groups and self.deep):
            return
        with shaders.drawing('MULTIPLY', 'LESS_EQUAL'):
            shaders.fill(*shaders.covering(), {"t_covering": upload(covering_table(self.camera, depths, window, floor, marks)),
                                        "t_own": self._targets[0][0]["t_own"]})

    def free(self) -> None:
        """Free the targets."""
        self._targets, self.groups = [], []
        self.size = self._drawn = self._no_depth = self._sky = self._shown = self._put = self._before = None

    def _kind(self, number):
        return self._kinds(self.groups, self.deep)[number]

    @staticmethod
    def _kinds(groups: list[Group], deep: bool) -> list[tuple[bool, bool]]:
        """Of each group, whether it has features, and whether the splats' own share of alpha, depth and mark are blended, too."""
        return [(group.instance is not None, deep or len(groups) > 1 or bool(group.marks)) for group in groups]

    def _resize(self, size, groups, deep):
        kinds = self._kinds(groups, deep)
        same = size == self.size and kinds == self._kinds(self.groups, self.deep)
        self.groups, self.size, self.deep = groups, size, deep
        if not same:
            self._targets = [_target(size, *kind) for kind in kinds]


def _target(size, features: bool, own: bool):
    names = ["t_first"] + ["t_second", "t_third"] * features + ["t_own"] * own
    textures = {name: gpu.types.GPUTexture(size, format=FORMAT) for name in names}
    return textures, gpu.types.GPUFrameBuffer(color_slots=tuple(textures.values()))
