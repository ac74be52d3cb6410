# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds the cameras of a capture without poses, by COLMAP's mapper (pycolmap) on the pictures of one frame.

The rig stands still and all its cameras see the scene at once, so one frame says where they are.  Pictures of one size are taken
to come from one kind of camera.
"""
import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict
from itertools import count
from pathlib import Path

import numpy as np

from ...cameras import poses
from ...cameras.camera import Camera
from ...cameras.lens import Lens
from ...captures.capture import Capture, Shot
from ...captures.pixels.store import FrameStore
from ...captures.posing import with_cameras
from ...util import rotations
from ...util.documentation import page
from ...util.errors import FastGSError
from ...util.outputs import replacing
from ...util.reading import read_json, reading
from .features import MOST_FEATURES, PEAK, pycolmap_module

TRIES = 3
"""Frames that are tried until one shows where all cameras are."""
PARTS = 4
"""Of the work on one frame: pictures, features, matches, the mapper."""
LEAST_VIEWS = 2
FILE = "poses.json"


def with_poses(capture: Capture, store: FrameStore, out: str | Path, say: Callable[[str], None] = print,
               progress: Callable[[int, int], None] = lambda done, of: None) -> Capture:
    """The capture with a camera for each view; `store` gives its pictures, `out` is the run's folder, which keeps the poses.

    Returns the capture itself where it has poses.  Raises FastGSError where the mapper finds none.
    """
    if capture.posed:
        return capture
    path = Path(out) / FILE
    known = kept(path, capture) if path.exists() else None
    if known:
        return with_cameras(capture, *known)
    cameras, lenses, frame = calibrated(capture, store, progress)
    say(f"poses: {len(cameras)} of {len(capture.views)} cameras found by pycolmap from frame {frame}")
    path.parent.mkdir(parents=True, exist_ok=True)
    keep(path, capture, cameras, lenses)
    return with_cameras(capture, cameras, lenses)


def calibrated(capture: Capture, store: FrameStore,
               progress: Callable[[int, int], None] = lambda done, of: None) -> tuple[dict[str, Camera], dict[str, Lens], int]:
    """Camera and lens of each view that the mapper can place, and the frame that showed it; the world's y axis points down.

    progress(done, of) is called before each part of a try: pictures, features, matches and the mapper.
    """
    parts, of = count(), PARTS * TRIES
    frames = sorted({shot.frame for shot in capture.shots})
    best: tuple[dict, dict, int] = ({}, {}, frames[0])
    for frame in dict.fromkeys([frames[0], frames[len(frames) // 2], frames[-1]][:TRIES]):
        cameras, lenses = mapped(capture.at_frame(frame), store, lambda: progress(next(parts), of))
        if len(cameras) > len(best[0]):
            best = cameras, lenses, frame
        if len(cameras) == len(capture.views):
            break
    if len(best[0]) < LEAST_VIEWS:
        raise FastGSError(f"{capture.path}: it has no poses, and pycolmap finds no two cameras that see the same things; "
                          f"give the poses in a cameras.json ({page('captures')}) or as a COLMAP workspace.")
    return best


def mapped(shots: Sequence[Shot], store: FrameStore,
           tick: Callable[[], None] = lambda: None) -> tuple[dict[str, Camera], dict[str, Lens]]:
    """COLMAP's incremental mapper on the pictures of some shots: cameras and lenses by view, of its largest model; tick() is called
    before each of PARTS."""
    from PIL import Image

    pycolmap = pycolmap_module()
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.use_gpu, extraction.num_threads = False, 1
    extraction.sift.max_num_features, extraction.sift.peak_threshold = 2 * MOST_FEATURES, PEAK
    matching = pycolmap.FeatureMatchingOptions()
    matching.use_gpu, matching.num_threads = False, 1
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed, options.min_model_size, options.multiple_models = 1, 0, LEAST_VIEWS, False
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "SIMPLE_RADIAL"
    pycolmap.set_random_seed(0)
    with tempfile.TemporaryDirectory() as folder:
        pictures, database = Path(folder, "pictures"), Path(folder, "database.db")
        pictures.mkdir()
        names = {f"{k:04}.png": shot.view for k, shot in enumerate(shots)}
        sizes = set()
        tick()
        for name, shot in zip(names, shots):
            rgb = store.pixels(shot).rgb
            sizes.add(rgb.shape)
            Image.fromarray(np.uint8(np.clip(rgb, 0, 1) * 255 + 0.5)).save(pictures / name)
        mode = pycolmap.CameraMode.SINGLE if len(sizes) == 1 else pycolmap.CameraMode.PER_IMAGE
        tick()
        pycolmap.extract_features(database, pictures, camera_mode=mode, reader_options=reader, extraction_options=extraction,
                                  device=pycolmap.Device.cpu)
        tick()
        pycolmap.match_exhaustive(database, matching_options=matching, device=pycolmap.Device.cpu)
        tick()
        models = pycolmap.incremental_mapping(database, pictures, Path(folder, "models"), options).values()
        if not models:
            return {}, {}
        model = max(models, key=lambda m: m.num_reg_images())
        images = [model.images[i] for i in model.reg_image_ids()]
        found = {names[image.name]: (np.vstack([image.cam_from_world().matrix(), (0, 0, 0, 1)]), image.camera) for image in images}
        turn = _upright([pose for pose, _ in found.values()])
        cameras, lenses = {}, {}
        for view, (pose, camera) in found.items():
            f, cx, cy, k = camera.params
            cameras[view] = Camera(camera.width, camera.height, f, f, cx, cy, pose @ turn.T)
            lenses[view] = Lens("opencv", (k,))
    return cameras, lenses


def _upright(poses: Sequence[np.ndarray]) -> np.ndarray:
    """The rotation [4, 4] of the world after which the cameras' mean downward direction is +y."""
    down = np.mean([pose[1, :3] for pose in poses], 0)
    down /= max(np.linalg.norm(down), 1e-12)
    right = np.mean([pose[0, :3] for pose in poses], 0)
    right -= (right @ down) * down
    if min(np.linalg.norm(down), np.linalg.norm(right)) < 1e-3:
        return np.eye(4)
    right /= np.linalg.norm(right)
    return rotations.transform((right, down, np.cross(right, down)))


def keep(path: Path, capture: Capture, cameras: dict[str, Camera], lenses: dict[str, Lens]) -> None:
    """Write the poses of a capture's views into a file: first under another name, then renamed."""
    values = {view: {**{n: getattr(c, n) for n in ("width", "height", "fx", "fy", "cx", "cy")},
                     "world_to_camera": c.world_to_camera.tolist(), "lens": asdict(lenses[view])} for view, c in cameras.items()}
    with replacing([path]) as (part,):
        part.write_text(json.dumps({"capture": str(Path(capture.path).resolve()), "cameras": values}, indent=1), "utf-8")


def kept(path: Path, capture: Capture) -> tuple[dict[str, Camera], dict[str, Lens]] | None:
    """The cameras and lenses in a file, None if they are another capture's; raises FastGSError."""
    again = "delete it to find the poses again"
    with reading(path, again):
        values = read_json(path, advice=again)
        if values["capture"] != str(Path(capture.path).resolve()):
            return None
        cameras, lenses = {}, {}
        for view, entry in values["cameras"].items():
            where = f"{path}: the camera of {view}"
            lens = entry["lens"]
            k, p = (tuple(poses.numbers(v, (len(v),), where)) for v in (lens["k"], lens["p"]))
            lenses[view] = Lens(lens["model"], k, p, poses.number(lens["skew"], where))
            known = poses.intrinsics(where, *(entry[name] for name in ("fx", "fy", "cx", "cy", "width", "height")))
            cameras[view] = Camera(known.width, known.height, known.fx, known.fy, known.cx, known.cy,
                                   poses.rigid(entry["world_to_camera"], where))
        return cameras, lenses
