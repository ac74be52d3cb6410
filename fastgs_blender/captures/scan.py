# SPDX-License-Identifier: GPL-3.0-or-later
"""A scan: photographs of the place that a capture films, such as a walk around it while it is empty.

Its pictures join the capture as shots to train on.  They belong to no moment: what moves in the films is not asked for in them.
"""
from dataclasses import replace

import numpy as np

from ..formats.turning import into_rdf
from ..util import rotations
from ..util.errors import FastGSError
from .capture import Capture, Shot

VIEW = "scan/"
"""Before the names of a scan's views, so that no camera of the rig has the same."""


def with_scan(capture: Capture, scan: Capture) -> Capture:
    """The capture with the pictures that a scan has for training, no larger than the capture's own.

    Both have poses in one world; their axes may be named differently.  Raises FastGSError where one has no poses, where the scan has no
    picture to train on, or where its masks mean something else.
    """
    lost = next((each for each in (capture, scan) if not each.posed), None)
    if lost is not None:
        raise FastGSError(f"{lost.path}: a capture and a scan of its place need poses in one world; find the poses of films and "
                          "photographs together.")
    photographs = scan.training
    if not photographs:
        raise FastGSError(f"{scan.path}: this scan has no pictures to train on.")
    masked = [{shot.mask is not None for shot in each.shots} for each in (capture, scan)]
    if all(True in each for each in masked) and capture.mask_means != scan.mask_means:
        raise FastGSError(f"{scan.path}: the masks of this scan mean something else ({scan.mask_means}) than the capture's "
                          f"({capture.mask_means}).")
    side = max(max(shot.camera.width, shot.camera.height) for shot in capture.shots if shot.camera is not None)
    turn = rotations.transform(into_rdf(scan.axes).T @ into_rdf(capture.axes))
    means = capture.mask_means if True in masked[0] else scan.mask_means
    shots = [_joined(shot, turn, side) for shot in photographs]
    notes = [*capture.notes, f"{len(shots)} pictures of the scan {scan.path} show the place"]
    return replace(capture, shots=capture.shots + shots, mask_means=means, notes=notes)


def _joined(shot: Shot, turn: np.ndarray, side: int) -> Shot:
    """A scan's shot in the capture's world, its longer side at most `side`."""
    camera = shot.camera
    assert camera is not None
    factor = min(1.0, side / max(camera.width, camera.height))
    camera = camera.stretched(round(camera.width * factor), round(camera.height * factor))
    camera = replace(camera, world_to_camera=camera.world_to_camera @ turn)
    return replace(shot, view=VIEW + shot.view, frame=0, t=0.0, camera=camera, place=True)
