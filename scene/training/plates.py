# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes a capture of the scene's own cameras with films or image sequences as backgrounds; files are linked where possible."""
import os
import re
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import bpy

from ... import fastgs_blender as fg
from ...fastgs_blender.captures.layouts import fastgs
from ...fastgs_blender.util.errors import FastGSError
from .. import camera as cameras
from ..filming.film import camera_entry, file_names, steady_lens
from ..frame_range import frame_kept

AXES = "RFU"
PICTURES = (".png", ".jpg", ".jpeg", ".exr")


@dataclass(frozen=True)
class Plate:
    """The background of a camera: the film or the image sequence that it filmed.

    path         a film, or any picture of a sequence
    film         whether it is a film
    first, last  scene frames on which there are pictures
    shift        number of the picture on scene frame f is f + shift; of a film, counted from 0
    size         of the pictures in pixels
    method       how they fill the camera's frame: STRETCH, FIT or CROP
    """

    path: Path
    film: bool
    first: int
    last: int
    shift: int
    size: tuple[int, int]
    method: str

    def file(self, frame: int) -> Path:
        """The picture of a sequence on a scene frame."""
        digits = re.search(r"(\d+)(?=\D*$)", self.path.name)
        number = f"{frame + self.shift:0{len(digits[1])}}"
        return self.path.with_name(f"{self.path.name[:digits.start()]}{number}{self.path.name[digits.end():]}")


def filmed(scene: bpy.types.Scene) -> dict[bpy.types.Object, Plate]:
    """The scene's cameras with a film or an image sequence as background; raises FastGSError if one is moved, turned or flipped."""
    found = {}
    for obj in scene.objects:
        if obj.type == 'CAMERA':
            plate = next((plate for background in obj.data.background_images if (plate := _plate(obj, background))), None)
            if plate:
                found[obj] = plate
    return found


def count(scene: bpy.types.Scene) -> int:
    """The number of the scene's cameras with a film or an image sequence as background; no file is read."""
    return sum(any(_has_plate(background) for background in obj.data.background_images) for obj in scene.objects if obj.type == 'CAMERA')


def _has_plate(background) -> bool:
    if background.source == 'IMAGE':
        return background.image is not None and background.image.source in ('SEQUENCE', 'MOVIE')
    return background.clip is not None or background.use_camera_clip


def _plate(obj, background) -> Plate | None:
    if background.source == 'IMAGE' and background.image and background.image.source in ('SEQUENCE', 'MOVIE'):
        image, user = background.image, background.image_user
        film = image.source == 'MOVIE'
        count = max(user.frame_duration, 1)
        shift = user.frame_offset - user.frame_start + (0 if film else 1)
        path = bpy.path.abspath(image.filepath, library=image.library)
        size = tuple(image.size) if film else _size(path)
        first = user.frame_start
    elif background.source == 'MOVIE_CLIP' and (clip := background.clip if not background.use_camera_clip else _scene_clip(obj)):
        film = clip.source == 'MOVIE'
        path, size = bpy.path.abspath(clip.filepath, library=clip.library), tuple(clip.size)
        count, first = clip.frame_duration, clip.frame_start
        number = re.search(r"(\d+)(?=\D*$)", Path(path).name)
        shift = clip.frame_offset - first + (0 if film else int(number[1]) if number else 0)
    else:
        return None
    if not min(size):
        raise FastGSError(f'the background of the camera "{obj.name}" cannot be read ({path}); find the file, or remove the background.')
    askew = background.rotation or background.use_flip_x or background.use_flip_y or any(background.offset) or background.scale != 1
    if askew:
        raise FastGSError(f'the background of the camera "{obj.name}" is moved, turned, scaled or flipped; set it back.')
    if not film and not re.search(r"\d", Path(path).name):
        return None
    return Plate(Path(path), film, first, first + count - 1, shift, size, background.frame_method)


def _size(path: str) -> tuple[int, int]:
    """Size of a picture file, (0, 0) where it cannot be read; Blender's image has no size of its own if it is a sequence."""
    try:
        image = bpy.data.images.load(path, check_existing=False)
    except RuntimeError:
        return 0, 0
    size = tuple(image.size)
    bpy.data.images.remove(image)
    return size


def _scene_clip(obj):
    return next((scene.active_clip for scene in obj.users_scene if scene.active_clip), None)


def picture_camera(camera: fg.Camera, plate: Plate) -> fg.Camera:
    """The camera of the pictures, from the camera of the frame into which they are stretched, fitted or cropped."""
    width, height = plate.size
    across, down = camera.width / width, camera.height / height
    if plate.method != 'STRETCH':
        across = down = (min if plate.method == 'FIT' else max)(across, down)
    return replace(camera, width=width, height=height, fx=camera.fx / across, fy=camera.fy / down,
                   cx=(camera.cx - camera.width / 2) / across + width / 2, cy=(camera.cy - camera.height / 2) / down + height / 2,
                   window=None)


def write_capture(context, out: Path) -> str:
    """Write the capture that the scene's cameras filmed, on the frames of the scene on which all have pictures; returns its folder.

    The world is Blender's.  Raises FastGSError where there are too few cameras, or pictures are missing.
    """
    scene = context.scene
    plates = filmed(scene)
    if len(plates) < 2:
        raise FastGSError(f"{len(plates) or 'none'} of the scene's cameras has an image sequence or a film as background; training needs "
                          "several, so add them as the cameras' background images.")
    first = max(scene.frame_start, *(plate.first for plate in plates.values()))
    last = min(scene.frame_end, *(plate.last for plate in plates.values()))
    if last < first:
        raise FastGSError("the cameras' films have no frame of the scene in common; shift them, or the scene's range.")
    names = dict(zip(plates, file_names([obj.name for obj in plates])))
    poses = _poses(context, plates, range(first, last + 1))
    entries = []
    try:
        out.mkdir(parents=True, exist_ok=True)
        for obj, plate in plates.items():
            steady_lens(obj.name, poses[obj])
            entries.append(camera_entry(names[obj], poses[obj]) | _lay_out(out, names[obj], plate, first, last))
        fastgs.write_cameras(out, entries, frame_count=last - first + 1, fps=scene.render.fps / scene.render.fps_base, axes=AXES)
    except OSError as error:
        raise FastGSError(f"{out}: the capture cannot be written there ({error.strerror}); choose another folder.") from error
    return str(out)


def _poses(context, plates, frames) -> dict:
    """The library's camera of each plate on each frame; the scene's frame is put back."""
    found: dict = {obj: [] for obj in plates}
    with frame_kept(context.scene):
        for frame in frames:
            context.scene.frame_set(frame)
            depsgraph = context.evaluated_depsgraph_get()
            for obj, plate in plates.items():
                found[obj].append(picture_camera(_frame_camera(obj.evaluated_get(depsgraph), depsgraph), plate))
    return found


def _frame_camera(obj, depsgraph) -> fg.Camera:
    """The camera of a plate's frame: the camera that the scene renders, or the one that filmed, where it comes from a capture."""
    own_size, render = obj.data.fastgs, depsgraph.scene.render
    if own_size.width:
        width, height = own_size.width, own_size.height
        aspect = own_size.pixel_aspect_x, own_size.pixel_aspect_y
    else:
        width, height = (v * render.resolution_percentage // 100 for v in (render.resolution_x, render.resolution_y))
        aspect = render.pixel_aspect_x, render.pixel_aspect_y
    camera = cameras.camera_of(obj, cameras.RenderArea.full(width, height), depsgraph, aspect=aspect)
    if camera.orthographic:
        raise FastGSError(f'the camera "{obj.name}" is orthographic, and training needs perspective ones; remove its background.')
    return camera


def _lay_out(out: Path, name: str, plate: Plate, first: int, last: int) -> dict:
    """Link a plate's files to the places that the layout prescribes; returns further entries for cameras.json."""
    if not plate.path.exists() and plate.film:
        raise FastGSError(f"{plate.path}: this film is not there; find it in the camera's background image.")
    if plate.film:
        _link(plate.path, out / (name + plate.path.suffix.lower()))
        return {"video_start": first + plate.shift}
    if plate.path.suffix.lower() not in PICTURES:
        raise FastGSError(f"{plate.path}: training reads PNG, JPEG and EXR pictures; convert these.")
    (out / name).mkdir(exist_ok=True)
    for frame in range(first, last + 1):
        source = plate.file(frame)
        if not source.exists():
            raise FastGSError(f"{source}: the picture of frame {frame} is missing; shorten the scene's range, or find it.")
        _link(source, out / name / f"{frame - first + 1:05}{source.suffix.lower()}")
    return {}


def _link(source: Path, target: Path):
    """A link to a file: symbolic, else hard, else a copy."""
    if target.exists() or target.is_symlink():
        target.unlink()
    for make in (lambda: target.symlink_to(source.resolve()), lambda: os.link(source, target)):
        try:
            return make()
        except OSError:
            continue
    return shutil.copyfile(source, target)
