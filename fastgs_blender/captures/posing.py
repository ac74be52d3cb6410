# SPDX-License-Identifier: GPL-3.0-or-later
"""with_cameras(): gives cameras to a capture that was filmed without poses."""
from collections.abc import Mapping
from dataclasses import replace

from ..cameras.camera import Camera
from ..cameras.lens import Intrinsics, Lens, pinhole_for
from ..util.errors import FastGSError
from .capture import Capture
from .pixels.probe import picture_size


def with_cameras(capture: Capture, cameras: Mapping[str, Camera], lenses: Mapping[str, Lens] | None = None) -> Capture:
    """The capture with these cameras of its views.

    cameras  intrinsics and pose of each view as the FrameStore gives its pictures so far (scaled, lens not undone)
    lenses   distortion of views that have any; their pictures are undistorted from now on
    Views without a camera are left out, with a note.  Raises FastGSError where none is left.
    """
    shots, known = [], {}
    for shot in capture.shots:
        camera = cameras.get(shot.view)
        if camera is None:
            continue
        if shot.view not in known:
            width, height = picture_size(shot.image)
            sx, sy = width / camera.width, height / camera.height
            source = Intrinsics(camera.fx * sx, camera.fy * sy, camera.cx * sx, camera.cy * sy, width, height)
            lens = (lenses or {}).get(shot.view, Lens())
            known[shot.view] = lens, source, pinhole_for(lens, source, camera.world_to_camera, capture.scale)
        lens, source, pinhole = known[shot.view]
        shots.append(replace(shot, camera=pinhole, image=replace(shot.image, lens=lens, intrinsics=source)))
    if not shots:
        raise FastGSError(f"{capture.path}: none of its views {', '.join(capture.views[:8])} has a camera; it cannot be trained on.")
    lost = [view for view in capture.views if view not in known]
    note = [f"left out for want of a pose: {', '.join(lost)}"] if lost else []
    return replace(capture, shots=shots, notes=[*capture.notes, *note])
