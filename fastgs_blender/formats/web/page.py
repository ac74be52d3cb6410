# SPDX-License-Identifier: GPL-3.0-or-later
"""A page as data, and as the text of one HTML file that asks for nothing else.

The file holds, beside the player's script and style:

    script id="scene"     JSON, the description below
    script id="model-<i>" base64 of model i, a compressed .safetensors file (formats/compressed.py) as it is
    script id="<name>"    the text of each worker, <name>_worker.js joined with what it imports
    img id="poster"       the opening picture, seen until the player draws, and without JavaScript

The description.  Matrices are 16 numbers, row by row.  A list "one, or one for each frame" has 1 or `frames` members; between frames the
player interpolates them.  After the last frame the last one stays.

    version     1
    title       text
    background  [r, g, b] linear.  A pixel's colour is un-premultiplied in the models' colour space, made scene linear, put over this by
                alpha, and shown through the sRGB curve (Blender's view transform Standard)
    fps, frames, loop   the scene's time line; frame f is shown f / fps seconds after the beginning
    opening     {"moves": whether there is a camera for each frame, "cameras": [{"pose": camera to world, in OpenCV axes,
                "fx", "fy", "cx", "cy", "width", "height", "orthographic"}]}
    pivot, up   [x, y, z] in the world: what the view turns around, and the direction that stays upright
    objects     of each: "model": i, and perhaps "like": k, a former object whose members it has but for its own;
                "places": model to world, and "looks": rows of looks.look_numbers(), one, or one for each frame;
                "times": the model's t for each frame, or empty: t = frame / frames;
                "crops": one list, or one for each frame, of {"matrix", "remove", "shape": "BOX", "SPHERE" or "VOLUME", "soft", "volume"};
                "backdrop", "bends": as in ObjectSettings;
                "sampling": null, or how the capture's cameras sampled the model, the fields of distance.Sampling but pixel
                of a piece of a long clip also "shown": [t from, t until], "clip": [begin, length in t] of its model's own time, and
                "count": of its Gaussians; its file is read when it is shown, or comes next
    volumes     of each, used by crops: {"side": R, "depth": base64 of float32 [R, R, R]}
    parts       of each model and the sound, by its script's id: {"bytes", "crc": their CRC-32}
    workers     the CRC-32 of the text of each worker, by its script's id
    sound       null, or {"type": "audio/...", "start": seconds at which the scene begins, by the file's own time; negative: later},
                with script id="sound", base64
"""
import base64
import hashlib
import html
import json
import shutil
import tempfile
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from string import Template
from typing import Any, TextIO

import numpy as np

from ...cameras.camera import Camera
from ...model.gaussians import GaussianModel
from ...rendering.crops import Crop
from ...rendering.instances import Instance, ObjectSettings
from ...rendering.looks import look_numbers
from ...rendering.volumes import Volume
from ...util.errors import FastGSError
from ..base import generator
from . import library
from .joining import joined

VERSION = 1
PLAYER = Path(__file__).parent / "player"
POLICY = ("default-src 'none'; script-src 'sha256-{script}'; style-src 'sha256-{style}'; img-src data:; media-src blob: data:; "
          "worker-src blob:; base-uri 'none'; form-action 'none'")
"""What the page may load: its own script and style, and what lies in it.  A rule for pages that end in their head comes before it."""


@dataclass(frozen=True)
class PagePiece:
    """What makes an object a piece of a long clip: how many Gaussians it has, (from, until) when it is shown, and (begin, length) of its
    model's time, in the clip's t."""

    count: int
    shown: tuple[float, float]
    time: tuple[float, float]


@dataclass(frozen=True, eq=False)
class PageObject:
    """A model in a page's scene.  Lists have one member, or one for each frame of the page.

    places    [4, 4] from the model's space to the world
    times     the model's t for each frame of the page; (): t = frame / frames
    settings  how it is shown.  Filters, mask and density are those of the first: the file leaves the others' Gaussians out
    piece     of a long clip, whose model stands for its file and has no Gaussians; None: a whole model
    """

    model: GaussianModel
    places: Sequence[np.ndarray] = (np.eye(4),)
    times: Sequence[float] = ()
    settings: Sequence[ObjectSettings] = (ObjectSettings(),)
    piece: PagePiece | None = None

    def at(self, frame: int, frames: int) -> Instance:
        """What fg.render() draws of it on a frame of the page."""
        t = self.times[frame] if len(self.times) else frame / frames
        return Instance(self.model, _of(self.places, frame), t, _of(self.settings, frame))

    @cached_property
    def shown(self) -> GaussianModel:
        """The model without the Gaussians that filters, mask and density hide: what the page's file holds."""
        hidden = self.at(0, 1).hidden
        return self.model.take(~hidden) if hidden.any() else self.model

    @property
    def key(self) -> tuple:
        """Objects with the same key share a file."""
        first = self.settings[0]
        return id(self.model), first.filters, first.mask, first.density


@dataclass(frozen=True, eq=False)
class Sound:
    """A sound file's bytes and MIME type; start: the second of it at which the scene begins, negative where it begins later."""

    data: bytes
    type: str
    start: float = 0.0


@dataclass(frozen=True, eq=False)
class Page:
    """What a page shows.

    cameras     the opening view, or one for each frame: the opening move
    pivot, up   [3] what the view turns around, and the direction that stays upright
    background  linear
    poster      PNG of the opening picture, or None
    """

    objects: Sequence[PageObject]
    cameras: Sequence[Camera]
    title: str = "4D Gaussians"
    frames: int = 1
    fps: float = 30.0
    loop: bool = True
    background: Sequence[float] = (0.0, 0.0, 0.0)
    pivot: Sequence[float] = (0.0, 0.0, 0.0)
    up: Sequence[float] = (0.0, 0.0, 1.0)
    sound: Sound | None = None
    poster: bytes | None = None

    def instances(self, frame: int) -> list[Instance]:
        """The scene on a frame, for fg.render()."""
        return [each.at(frame, self.frames) for each in self.objects]

    @cached_property
    def models(self) -> dict[tuple, GaussianModel]:
        """The models of the files that the page holds, by their objects' keys."""
        return {each.key: each.shown for each in self.objects}

    def description(self) -> dict[str, Any]:
        """The JSON of the page."""
        volumes: dict[str, Volume] = {}
        numbers = {key: i for i, key in enumerate(self.models)}
        objects: list[dict[str, Any]] = []
        told: dict[tuple, int] = {}  # the pieces of a clip share what is told of each frame
        for each in self.objects:
            alike = tuple(map(id, (each.places, each.times, each.settings, each.shown.surroundings)))
            piece = {} if each.piece is None else {
                "shown": list(each.piece.shown), "clip": list(each.piece.time), "count": each.piece.count}
            shared = {"like": told[alike]} if piece and alike in told else self._object(each, volumes)
            told.setdefault(alike, len(objects))
            objects.append(piece | shared | {"model": numbers[each.key]})
        depths = [{"side": len(depth), "depth": _base64(np.ascontiguousarray(depth, "<f4").tobytes())}
                  for depth in (volume.depth for volume in volumes.values())]
        return {
            "version": VERSION, "title": self.title, "background": _numbers(self.background), "fps": float(self.fps),
            "frames": int(self.frames), "loop": bool(self.loop),
            "opening": {"moves": len(self.cameras) > 1, "cameras": [_camera(camera) for camera in self.cameras]},
            "pivot": _numbers(self.pivot), "up": _numbers(self.up), "objects": objects, "volumes": depths,
            "sound": {"type": self.sound.type, "start": self.sound.start} if self.sound else None,
        }

    def _object(self, shown: PageObject, volumes: dict[str, Volume]) -> dict[str, Any]:
        first = shown.settings[0]
        sampling = Instance(shown.model, np.eye(4), 0.0, first).captured
        return {
            "places": [_numbers(place) for place in shown.places], "times": _numbers(shown.times),
            "looks": _changing([_numbers(look_numbers(each, shown.model.colour_space)) for each in shown.settings]),
            "crops": _changing([[_crop(crop, volumes) for crop in each.crops] for each in shown.settings]),
            "backdrop": first.backdrop, "bends": first.bends,
            "sampling": None if not sampling.known else {
                "ball": _numbers(sampling.ball), "coarse": sampling.coarse, "least": sampling.least, "reach": sampling.reach,
                "cameras": [_numbers(row) for row in sampling.cameras]},
        }


def write_page(stream: TextIO, page: Page, files: Iterable[bytes]) -> None:
    """Write the HTML of a page whose models lie in these compressed files, one for each of page.models.

    One file after another is asked for, and none stays in memory.
    """
    player = player_files()
    workers = {name.removesuffix(".js"): joined(name, player) for name in player if name.endswith("_worker.js")}
    parts = {}
    with tempfile.TemporaryFile("w+", encoding="ascii", newline="\n") as spool:  # the description comes first, and sums them up
        for i, data in enumerate(files):
            parts[f"model-{i}"] = _kept(spool, f"model-{i}", data)
        if page.sound:
            parts["sound"] = _kept(spool, "sound", page.sound.data)
        description = page.description() | {"parts": parts, "workers": {name: zlib.crc32(text.encode()) for name, text in workers.items()}}
        script, style = joined("main.js", player), player["page.css"]
        picture = f'src="data:image/png;base64,{_base64(page.poster or b"")}"'
        poster = f'<img id="poster" alt="{html.escape(page.title)}" {picture}>' if page.poster else ""
        head, _, tail = player["template.html"].partition("$data")
        stream.write(Template(head).substitute(
            policy=POLICY.format(script=_digest(script), style=_digest(style)), generator=html.escape(generator()),
            title=html.escape(page.title), style=style, poster=poster, script=script))
        stream.write(_data("scene", "application/json", json.dumps(description, separators=(",", ":"), allow_nan=False)))
        stream.writelines("\n" + _data(name, "text/plain", text) for name, text in workers.items())
        spool.seek(0)
        shutil.copyfileobj(spool, stream)
        stream.write(tail)


def _kept(stream: TextIO, name: str, data: bytes) -> dict[str, int]:
    """Write a file as a block of data; returns what the description says of it."""
    stream.write("\n" + _data(name, "text/plain", _base64(data)))
    return {"bytes": len(data), "crc": zlib.crc32(data)}


def player_files() -> dict[str, str]:
    """The texts of the player's files by their paths in its folder, in the order of their names, and of the modules that are made."""
    return library.modules() | {path.relative_to(PLAYER).as_posix(): path.read_text("utf-8") for path in sorted(PLAYER.rglob("*"))
                                if path.suffix in (".js", ".css", ".html")}


def _of(several: Sequence, frame: int) -> Any:
    return several[min(frame, len(several) - 1)]


def _changing(rows: list) -> list:
    """The rows of all frames, or one where all are equal."""
    return rows[:1] if all(row == rows[0] for row in rows) else rows


def _numbers(values: Any) -> list[float]:
    """Values of any shape as a flat list; raises FastGSError where one is not finite."""
    flat = np.asarray(values, np.float64).ravel()
    if not np.isfinite(flat).all():
        raise FastGSError("the scene has places, times or colours that are no numbers; look for them in its animation.")
    return flat.tolist()


def _camera(camera: Camera) -> dict[str, Any]:
    return {"pose": _numbers(np.linalg.inv(camera.world_to_camera)), "orthographic": bool(camera.orthographic),
            **{key: float(getattr(camera, key)) for key in ("fx", "fy", "cx", "cy", "width", "height")}}


def _crop(crop: Crop, volumes: dict[str, Volume]) -> dict[str, Any]:
    matrix = np.asarray(crop.matrix, np.float64)
    found = {"matrix": _numbers(matrix) if np.isfinite(matrix).all() else None, "remove": crop.remove, "soft": float(crop.soft)}
    if not isinstance(crop.shape, Volume):
        return found | {"shape": crop.shape}
    volumes.setdefault(crop.shape.digest, crop.shape)
    return found | {"shape": "VOLUME", "volume": list(volumes).index(crop.shape.digest)}


def _data(name: str, kind: str, text: str) -> str:
    """A block of data, which no browser runs."""
    if kind == "application/json":
        text = text.replace("<", "\\u003c")
    return f'<script type="{kind}" id="{name}">{text}</script>'


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _digest(text: str) -> str:
    return _base64(hashlib.sha256(text.encode()).digest())
