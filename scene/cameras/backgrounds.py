# SPDX-License-Identifier: GPL-3.0-or-later
"""The pictures of a capture's views as backgrounds of Blender's cameras."""
import re
from dataclasses import dataclass
from pathlib import Path

import bpy


@dataclass(frozen=True)
class Reel:
    """A view's pictures as Blender plays them.

    path    the film, the first picture of a sequence, or the still
    source  'MOVIE', 'SEQUENCE' or 'FILE'
    count   of pictures, one a frame
    offset  of the first picture in the film or in its sequence
    """

    path: Path
    source: str
    count: int
    offset: int


def reel_of(shots: list) -> Reel:
    """How to play these shots' files, one a frame, in order; a still where Blender could not.  A frame that is missing stays empty."""
    first, count = shots[0].image, shots[-1].frame - shots[0].frame + 1
    sources = [(shot.frame - shots[0].frame, shot.image) for shot in shots]
    if first.frame is not None:
        even = all(s.path == first.path and s.frame == first.frame + i for i, s in sources)
        return Reel(first.path, 'MOVIE', count if even else 1, first.frame)
    digits = re.search(r"(\d+)(?=\D*$)", first.path.name)
    if digits is None or count == 1:
        return Reel(first.path, 'FILE', 1, 0)
    number, width = int(digits[1]), len(digits[1])
    head, tail = first.path.name[:digits.start()], first.path.name[digits.end():]
    if any(source.path != first.path.with_name(f"{head}{number + i:0{width}}{tail}") for i, source in sources):
        return Reel(first.path, 'FILE', 1, 0)
    return Reel(first.path, 'SEQUENCE', count, number - 1)


def show_behind(data: bpy.types.Camera, reel: Reel, start: int) -> None:
    """Make a reel the camera's background, its first picture on frame `start` of the scene, filling the camera's frame."""
    image = bpy.data.images.load(str(reel.path), check_existing=True)
    if reel.source != 'FILE':
        image.source = reel.source
    background = data.background_images.new()
    background.image = image
    background.frame_method, background.display_depth, background.alpha = 'STRETCH', 'BACK', 1.0
    user = background.image_user
    user.frame_start, user.frame_duration, user.frame_offset = start, reel.count, reel.offset
    user.use_auto_refresh, user.use_cyclic = True, False
    data.show_background_images = True
