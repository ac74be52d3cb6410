# SPDX-License-Identifier: GPL-3.0-or-later
"""Films the open scene, picture by picture, into a capture of our layout; pictures that exist already are kept."""
import json
import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

import bpy
import numpy as np

from ... import fastgs_blender as fg
from ...fastgs_blender.captures import generated
from ...fastgs_blender.captures.layouts import fastgs
from ...fastgs_blender.util.errors import FastGSError
from ...fastgs_blender.util.outputs import replacing
from ...fastgs_blender.util.picture_files import read_exr, write_exr, write_png
from ...fastgs_blender.util.reading import read_json
from .. import arrays
from ..background import relayed
from .baked import bake_filmed_steps
from .studio import Studio
from .subject import find

POINTS = 20_000
"""Starting points that the depth gives."""
FILMED = "filmed.json"
"""In a capture's folder: which objects of the scene its pictures show."""
AXES = "RFU"
"""A Blender scene's world: x right, y forward, z up."""


@dataclass(frozen=True)
class Plan:
    """The settings of a filming, as in the operator's properties; cameras: names of the scene's own, () for a rig of `count` new ones."""

    frame_start: int
    frame_end: int
    frame_step: int = 1
    width: int = 640
    height: int = 480
    samples: int = 16
    cameras: tuple[str, ...] = ()
    count: int = 12
    rig: str = "dome"
    angle: float = 42.0
    distance: float = 1.0
    selected: tuple[str, ...] | None = None
    hold_out: bool = True
    world: str = 'AUTO'

    @property
    def frames(self) -> list[int]:
        return list(range(self.frame_start, self.frame_end + 1, self.frame_step))


def film_steps(scene: bpy.types.Scene, plan: Plan, out):
    """A generator that films: it yields (done, in all), of pictures and then, with a third member, of a bake of what they show; it
    returns notes on what is not available.

    Pictures, masks and depth that are in the folder already are kept.  Raises FastGSError.
    """
    out = Path(out)
    yield 0, len(plan.frames) * (len(plan.cameras) or plan.count)
    with Studio(scene, plan.width, plan.height, plan.samples, plan.world) as studio:
        subject = find(studio, plan.frames, None if plan.selected is None else set(plan.selected))
        views = _chosen(studio, plan) if plan.cameras else _rig(plan, subject)
        _describe(out, scene, plan, views)
        _list(out, subject.everything)
        every = [(number, frame, view) for number, frame in enumerate(plan.frames) for view in views]
        work = [(number, frame, view) for number, frame, view in every if not (out / view / f"{number + 1:04}.png").exists()]
        notes: set[str] = set()
        there = None
        for done, (number, frame, view) in enumerate(work, len(every) - len(work)):
            yield done, len(every)
            if frame != there:
                studio.go_to(frame)
                there = frame
            picture = studio.film(views[view][number], subject.names)
            if picture.cover is None:
                notes.add("the render engine has no Cryptomatte, so there are no masks")
            if picture.depth is None:
                notes.add("the render engine gives no depth, so there are no starting points from it")
            _write(out, view, f"{number + 1:04}", picture)
        _write_points(out, plan, views)
        baking = bake_filmed_steps(studio, plan, subject.everything, _rate(scene, plan), out)
        note = yield from relayed(baking, lambda share: (round(100 * share), 100, "Baking"))
    return sorted(notes | ({note} if note else set()))


def _rate(scene, plan) -> float:
    """Frames per second of the capture."""
    return scene.render.fps / scene.render.fps_base / plan.frame_step


def _rig(plan, subject) -> dict[str, list[fg.Camera]]:
    """Cameras around the subject; the first looks from the front, and is the one that is held out."""
    focal = min(plan.width, plan.height) / 2 / np.tan(np.radians(plan.angle) / 2)
    distance = plan.distance * subject.radius / np.sin(np.radians(plan.angle) / 2)
    digits = max(len(str(plan.count - 1)), 2)
    eyes = subject.centre + distance * generated.directions(plan.count, plan.rig)
    views = {}
    for k, eye in enumerate(eyes):
        camera = fg.Camera(plan.width, plan.height, focal, focal, plan.width / 2, plan.height / 2,
                           fg.look_at(eye, subject.centre), near=max(1e-3 * distance, 1e-4))
        views[f"cam{k:0{digits}}"] = [camera] * len(plan.frames)
    return views


def _chosen(studio, plan) -> dict[str, list[fg.Camera]]:
    """The scene's own cameras of these names, frame by frame."""
    views: dict[str, list[fg.Camera]] = {}
    for frame in plan.frames:
        studio.go_to(frame)
        for name in plan.cameras:
            obj = studio.scene.objects.get(name)
            if obj is None or obj.type != 'CAMERA':
                raise FastGSError(f'the scene has no camera "{name}"; choose others.')
            views.setdefault(name, []).append(studio.filmed_by(obj))
    for name, shots in views.items():
        steady_lens(name, shots)
    return dict(zip(file_names(views), views.values()))


def camera_entry(name: str, shots: list[fg.Camera]) -> dict:
    """What cameras.json says of a camera: its lens, and its pose, or those of all frames where it moves."""
    first = shots[0]
    still = all(np.allclose(shot.world_to_camera, first.world_to_camera, rtol=0, atol=1e-9) for shot in shots)
    pose = first.world_to_camera if still else np.array([shot.world_to_camera for shot in shots])
    return dict(name=name, width=first.width, height=first.height, fx=first.fx, fy=first.fy, cx=first.cx, cy=first.cy,
                world_to_camera=np.round(pose, 12))


def steady_lens(name: str, shots: list[fg.Camera]) -> None:
    """Raises FastGSError where the lens of a camera changes from shot to shot."""
    lens = np.array([(c.fx, c.fy, c.cx, c.cy) for c in shots])
    if np.ptp(lens, axis=0).max() > 1e-3 * lens[0, 0]:
        raise FastGSError(f'the lens of the camera "{name}" is animated, which a capture cannot hold; choose others.')


def file_names(names: Iterable[str]) -> list[str]:
    """Names for the folders of cameras of these names."""
    found = [re.sub(r"[^\w.-]+", "_", name).strip(".") or "cam" for name in names]
    return [f"cam{k:02}" for k in range(len(found))] if len(set(found)) < len(found) or "masks" in found else found


def _describe(out: Path, scene, plan, views):
    """cameras.json; a folder that holds a capture with other settings is refused."""
    entries = [camera_entry(name, shots) for name, shots in views.items()]
    made = {**asdict(plan), "engine": scene.render.engine, "scene": scene.name}
    old = out / fastgs.FILE
    try:
        out.mkdir(parents=True, exist_ok=True)
        if old.exists():
            before = read_json(old)
            if before.get("made") == json.loads(json.dumps(made)) and len(before["cameras"]) == len(entries):
                return
            raise FastGSError(f"{out} holds a capture with other settings; choose another folder, or remove that one.")
        held_out = [next(iter(views))] if plan.hold_out and len(views) > 2 else []
        fastgs.write_cameras(out, entries, frame_count=len(plan.frames), fps=_rate(scene, plan), start_frame=1, held_out=held_out,
                             axes=AXES, made=made)
        for name in views:
            for folder in (out / name, out / "masks" / name, out / "depth" / name):
                folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise FastGSError(f"{out}: the capture cannot be written there ({getattr(error, 'strerror', None) or error}); choose another "
                          "folder.") from error


def _list(out: Path, names):
    """The file that says which of the scene's objects were filmed."""
    with replacing([out / FILMED]) as (part,):
        part.write_text(json.dumps({"objects": sorted(names)}, indent=1), "utf-8")


def filmed_objects(out) -> list[str]:
    """The names of the objects that a capture was filmed from; [] where its folder does not say.  Blender takes no lone surrogates."""
    try:
        names = read_json(Path(out) / FILMED)["objects"]
    except (FastGSError, KeyError, TypeError):
        return []
    return [name for name in names if isinstance(name, str) and not re.search("[\ud800-\udfff]", name)] if isinstance(names, list) else []


def _write(out: Path, view: str, name: str, picture):
    """Write a picture, its mask and depth, each under another name and then renamed; the picture last."""
    rgb = _bytes(picture.rgb if picture.alpha is None else np.concatenate([picture.rgb, picture.alpha[..., None]], -1))
    files = []
    if picture.depth is not None:
        files.append((out / "depth" / view / f"{name}.exr", lambda part: write_exr(part, {"Z": picture.depth})))
    if picture.cover is not None:
        files.append((out / "masks" / view / f"{name}.png", lambda part: write_png(part, _bytes(picture.cover))))
    files.append((out / view / f"{name}.png", lambda part: write_png(part, rgb)))
    for path, write in files:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing([path]) as (part,):
                write(part)
        except OSError as error:
            raise FastGSError(f"{path}: the picture cannot be written ({error.strerror}); free some space and start "
                              "again; finished pictures are kept.") from error


def _bytes(image):
    return np.floor(np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8)


def _write_points(out: Path, plan, views):
    """Write points.ply from the depth of all pictures: points in the masks belong to their frame, all others to all times."""
    path = out / "points.ply"
    if path.exists():
        return
    rng = np.random.default_rng(0)
    shots = [(number, view) for number in range(len(plan.frames)) for view in views
             if (out / "depth" / view / f"{number + 1:04}.exr").exists()]
    if not shots:
        return
    each = max(POINTS // len(shots), 1)
    if len(shots) > POINTS:
        shots = [shots[i] for i in np.linspace(0, len(shots) - 1, POINTS).astype(int)]
    columns = []
    for number, view in shots:
        name = f"{number + 1:04}"
        depth = read_exr(out / "depth" / view / f"{name}.exr")[0]["Z"]
        rows = np.flatnonzero(np.isfinite(depth))
        if not len(rows):
            continue
        picked = np.unique(rng.choice(rows, min(each, len(rows)), replace=False))
        y, x = np.divmod(picked, plan.width)
        mask = out / "masks" / view / f"{name}.png"
        moving = _pixels(mask)[y, x, 0] > 0.5 if mask.exists() else np.ones(len(x), bool)
        columns.append((generated.unproject(views[view][number], depth, y, x), _bytes(_pixels(out / view / f"{name}.png")[y, x, :3]),
                        np.where(moving, number / len(plan.frames), np.nan)))
    if columns:
        xyz, rgb, t = (np.concatenate(column) for column in zip(*columns))
        with replacing([path]) as (part,):
            generated.write_points(part, xyz, rgb, t)


def _pixels(path) -> np.ndarray:
    """The numbers [h, w, 4] of a picture file as they are, the top row first."""
    image = bpy.data.images.load(str(path), check_existing=False)
    try:
        image.colorspace_settings.name = 'Non-Color'
        return arrays.pixels(image)[::-1]
    finally:
        bpy.data.images.remove(image)
