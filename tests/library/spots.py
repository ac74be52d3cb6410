# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of round spots at known places, and the places of spots in a picture: tests check poses and lenses by projecting points."""
from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from fastgs_blender.cameras.camera import Camera
from fastgs_blender.cameras.lens import Intrinsics, Lens
from fastgs_blender.captures.capture import Capture
from fastgs_blender.captures.pixels.checks import problems
from fastgs_blender.captures.pixels.store import FrameStore


def draw_spots(width: int, height: int, pixels, sigma: float = 2.5) -> np.ndarray:
    """A float32 picture [height, width] 0..1 with a Gaussian spot at each of pixels [P, 2] (centres of pixels at +0.5)."""
    x, y = np.arange(width) + 0.5, np.arange(height) + 0.5
    image = np.zeros((height, width))
    for u, v in np.asarray(pixels, np.float64).reshape(-1, 2):
        image += np.exp(-0.5 * ((y - v) / sigma) ** 2)[:, None] * np.exp(-0.5 * ((x - u) / sigma) ** 2)
    return np.clip(image, 0, 1).astype(np.float32)


def find_spots(image: np.ndarray, near, reach: int = 8) -> np.ndarray:
    """The spots' centres [P, 2] in image [h, w]: the centroid of what is brighter than a third of the spot's peak, around each guess."""
    found = []
    for u, v in np.asarray(near, np.float64).reshape(-1, 2):
        x0, y0 = max(int(u) - reach, 0), max(int(v) - reach, 0)
        part = np.asarray(image, np.float64)[y0:int(v) + reach + 1, x0:int(u) + reach + 1]
        weight = np.maximum(part - part.max() / 3, 0)
        x, y = np.arange(part.shape[1]) + x0 + 0.5, np.arange(part.shape[0]) + y0 + 0.5
        found.append([(weight.sum(0) * x).sum() / weight.sum(), (weight.sum(1) * y).sum() / weight.sum()])
    return np.array(found)


def project(camera: Camera, xyz) -> np.ndarray:
    """World points [P, 3] in the pixels [P, 2] of a pinhole camera."""
    p = np.asarray(xyz, np.float64) @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    assert (p[:, 2] > 0).all()
    return p[:, :2] / p[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]


class SpotRig:
    """Cameras on an arc that look at white spots, some of which move: what layouts' tests write as files and find again.

    given    the intrinsics of all cameras, with the lens
    sigma    of the spots in the files' pixels
    spread   half the spots' distance across, in units of which the cameras are 3 away
    """

    def __init__(self, given: Intrinsics, lens: Lens | None = None, cameras: int = 4, frames: int = 3, sigma: float = 3.0,
                 spread: float = 0.6):
        self.given, self.lens, self.frames, self.sigma, self.spread = given, lens or Lens(), frames, sigma, spread
        self.poses = [self._pose(angle) for angle in np.linspace(-0.4, 0.4, cameras)]

    def _pose(self, angle, distance=3.0):
        turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        roll, nod = angle / 2, 0.1 + angle / 5
        turn = np.array([[1, 0, 0], [0, np.cos(nod), -np.sin(nod)], [0, np.sin(nod), np.cos(nod)]]) @ turn
        turn = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]]) @ turn
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn, [0.05, -0.03, distance + angle]
        return pose

    def points(self, frame: int) -> np.ndarray:
        """World points [9, 3] at a frame; those of the middle row move."""
        x, y = np.meshgrid([-1.0, 0.1, 1.0], [-0.8, 0.0, 0.8])
        xyz = np.stack([x, y, 0.3 * x * y + 0.1], -1)
        xyz[1] += [0.04 * frame, 0.08 * frame, -0.05 * frame]
        return xyz.reshape(-1, 3) * self.spread

    def pixels(self, camera: int, frame: int) -> np.ndarray:
        """Where the lens shows the points in the files, [9, 2]."""
        p = self.points(frame) @ self.poses[camera][:3, :3].T + self.poses[camera][:3, 3]
        return self.lens.distort(p[:, :2] / p[:, 2:]) * self.given[:2] + self.given[2:4]

    def picture(self, camera: int, frame: int) -> np.ndarray:
        """uint8 [height, width, 3]."""
        grey = draw_spots(self.given.width, self.given.height, self.pixels(camera, frame), self.sigma)
        return np.repeat(np.uint8(np.round(grey * 235))[..., None], 3, 2)

    def write_picture(self, path: Path, camera: int, frame: int):
        """One picture as PNG or JPEG."""
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(self.picture(camera, frame)).save(path, quality=95)

    def write_video(self, path: Path, camera: int, fps: int = 30, frames: int | None = None):
        """All frames of a camera as an H.264 video with frames that refer to later ones."""
        import av

        path.parent.mkdir(parents=True, exist_ok=True)
        with av.open(str(path), "w") as container:
            stream = container.add_stream("libx264", rate=fps, options={"crf": "4", "bf": "2", "g": "10"})
            stream.width, stream.height, stream.pix_fmt = self.given.width, self.given.height, "yuv420p"
            for frame in range(self.frames if frames is None else frames):
                container.mux(stream.encode(av.VideoFrame.from_ndarray(self.picture(camera, frame), format="rgb24")))
            container.mux(stream.encode(None))

    def check(self, capture: Capture, cache: Path, names: Sequence[str], world: np.ndarray | None = None):
        """That the capture has these cameras with this rig's poses, and that its undistorted pictures show the spots where its cameras
        project them, to 0.1 pixel.

        names   of the views in the rig's order
        world   [4, 4] from this rig's world to the capture's
        """
        world = np.eye(4) if world is None else world
        assert len(capture) == len(names) * self.frames and set(capture.views) == set(names) and not problems(capture)
        store = FrameStore(capture, folder=cache, whole=True)  # spots of light before black are no subject
        for shot in capture.shots:
            camera = names.index(shot.view)
            np.testing.assert_allclose(shot.camera.world_to_camera @ world, self.poses[camera], atol=1e-6)
            expected = project(shot.camera, self.points(shot.frame) @ world[:3, :3].T + world[:3, 3])
            shown = store.pixels(shot).rgb
            assert shown.shape == (shot.camera.height, shot.camera.width, 3)
            reach = round(3.5 * self.sigma * shot.camera.fx / self.given.fx)
            inside = ((expected > reach) & (expected < [shot.camera.width - reach, shot.camera.height - reach])).all(1)
            assert inside.sum() >= 6
            found = find_spots(shown.mean(-1), expected[inside], reach)
            assert np.abs(found - expected[inside]).max() <= 0.1, (shot.view, shot.frame)
