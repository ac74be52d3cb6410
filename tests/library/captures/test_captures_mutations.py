# SPDX-License-Identifier: GPL-3.0-or-later
"""Damaged captures: whatever a description, a picture, a video or a file of points holds, the answer is a capture or one sentence."""
from __future__ import annotations

import json
from pathlib import Path

import av
import mutations
import numpy as np
import OpenEXR
import pytest
import tiny_captures
from PIL import Image
from test_clocks import film

from fastgs_blender.captures import open_capture, recognised
from fastgs_blender.captures.clocks.sound import MOST_SECONDS, onsets
from fastgs_blender.captures.describe import describe, text
from fastgs_blender.captures.pixels import decoding, pictures, probe, video
from fastgs_blender.captures.point_files import load_points
from fastgs_blender.captures.sources import PICTURES, VIDEOS, Source
from fastgs_blender.util.errors import FastGSError, printable_lines


def check_capture(folder: Path, layout: str):
    recognised(folder)
    capture = open_capture(folder, layout=layout)
    assert len(capture) and len(capture.views) >= 1
    for shot in capture.shots:
        assert np.isfinite(shot.camera.world_to_camera).all() and 0 <= shot.frame < capture.clip.frame_count and np.isfinite(shot.t)
        shot.view.encode()
    found = describe(capture)
    json.dumps(found, allow_nan=False)
    assert text(found) == printable_lines(text(found))
    for shot in (capture.shots[0], capture.shots[-1]):
        for _, pixels in decoding.decode([shot], capture.scale):
            if isinstance(pixels, FastGSError):
                raise pixels
            assert pixels.shape == decoding.shape(shot, capture.scale)


@pytest.mark.slow
@pytest.mark.parametrize("layout", tiny_captures.LAYOUTS)
def test_damaged_descriptions(layout, tmp_path):
    seeds = {}
    for make in tiny_captures.LAYOUTS[layout]:
        folder = tmp_path / "made" / make.__name__
        folder.mkdir(parents=True)
        make(folder)
        seeds[make.__name__] = tiny_captures.contents(folder)
    fixed = {path for files in seeds.values() for path in files if Path(path).suffix in (*PICTURES, *VIDEOS)}
    mutations.campaign(f"captures-{layout}", lambda folder: check_capture(folder, layout), seeds, tmp_path, fixed=fixed)


def check_picture(folder: Path):
    (file,) = folder.iterdir()
    found = probe.facts(Source(file))
    rgb, alpha = pictures.read(Source(file))
    assert rgb.shape == (found.height, found.width, 3) and (rgb.dtype == np.float32) == found.deep
    assert np.isfinite(rgb).all() and rgb.min() >= 0 and (alpha is not None) == found.alpha
    pictures.read_grey(Source(file))


def test_damaged_pictures(tmp_path):
    x = np.arange(12 * 16 * 4).reshape(12, 16, 4)
    eight = np.uint8(x % 251)
    made = {"rgb": ("a.png", Image.fromarray(eight[..., :3]), {}), "rgba": ("a.png", Image.fromarray(eight), {}),
            "palette": ("a.png", Image.fromarray(eight[..., :3]).quantize(8), {"transparency": 3}),
            "bilevel": ("a.png", Image.fromarray(eight[..., 0] > 99), {}),
            "grey16": ("a.png", Image.fromarray(np.uint16(x[..., 0] * 80)), {}),
            "jpeg": ("a.jpg", Image.fromarray(eight[..., :3]), {"quality": 90}),
            "progressive": ("a.jpg", Image.fromarray(eight[..., :3]), {"progressive": True}),
            "cmyk": ("a.jpg", Image.fromarray(eight[..., :3]).convert("CMYK"), {})}
    seeds = {}
    for name, (file, image, settings) in made.items():
        image.save(tmp_path / file, **settings)
        seeds[name] = {file: (tmp_path / file).read_bytes()}
    mutations.campaign("pictures", check_picture, seeds, tmp_path)


def test_damaged_exr_pictures(tmp_path):
    rng = np.random.default_rng(1)
    planes = {name: rng.random((12, 16)).astype(np.float32) for name in ("R", "G", "B", "A", "Depth.Z", "Layer.R")}
    seeds = {}
    for name in ("NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "B44A", "DWAA", "DWAB"):
        kind = np.float16 if name in ("B44", "DWAA") else np.float32
        header = {"compression": getattr(OpenEXR, f"{name}_COMPRESSION"), "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, {channel: plane.astype(kind) for channel, plane in planes.items()}).write(str(tmp_path / "a.exr"))
        seeds[name] = {"a.exr": (tmp_path / "a.exr").read_bytes()}
    mutations.campaign("exr", check_picture, seeds, tmp_path)


def test_damaged_videos(tmp_path):
    kinds = {"h264": ("a.mp4", "libx264", {"g": "3", "bf": "2"}), "mpeg4": ("a.avi", "mpeg4", {}), "mjpeg": ("a.mov", "mjpeg", {}),
             "mpeg2": ("a.mpg", "mpeg2video", {}), "matroska": ("a.mkv", "libx264", {"g": "2"}), "vp9": ("a.webm", "libvpx-vp9", {}),
             "ts": ("a.ts", "libx264", {})}
    seeds = {}
    for name, (file, codec, options) in kinds.items():
        if codec in av.codecs_available:
            tiny_captures.video(tmp_path / file, codec=codec, **options)
            seeds[name] = {file: (tmp_path / file).read_bytes()}
    assert "h264" in seeds

    def read(folder):
        (file,) = folder.iterdir()
        found = video.index(file)
        assert found.count >= 1 and np.isfinite(found.fps) and found.fps > 0 and found.width > 0
        for _, pixels in video.frames(file, sorted({0, found.count // 2, found.count - 1})):
            assert pixels.ndim == 3 and pixels.dtype == np.uint8

    mutations.campaign("videos", read, seeds, tmp_path)


def test_damaged_sound(tmp_path):
    for name in ("a.mp4", "a.mkv"):
        film(tmp_path / name, 1.0, 0.0, [0.3, 0.7])
    seeds = {name[2:]: {name: (tmp_path / name).read_bytes()} for name in ("a.mp4", "a.mkv")}

    def read(folder):
        (file,) = folder.iterdir()
        heard = onsets(file)
        assert heard is None or (heard.ndim == 1 and len(heard) <= 1000 * MOST_SECONDS and np.isfinite(heard).all())

    mutations.campaign("sound", read, seeds, tmp_path)


def test_damaged_points(tmp_path):
    seeds = {}
    for name, ascii_ in (("ascii", True), ("binary", False)):
        tiny_captures.points(tmp_path / "points.ply", ascii_)
        seeds[name] = {"points.ply": (tmp_path / "points.ply").read_bytes()}

    def read(folder):
        points = load_points(folder / "points.ply")
        assert np.isfinite(points.xyz).all() and 0 <= points.rgb.min(initial=0) <= points.rgb.max(initial=0) <= 1

    mutations.campaign("points", read, seeds, tmp_path)
