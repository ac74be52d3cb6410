# SPDX-License-Identifier: GPL-3.0-or-later
"""Real Blenders, each in its Debian root, with the extension installed from its zip.  tools/test_blender.py starts these tests."""
from __future__ import annotations

import os
import shutil
from pathlib import Path

import models
import numpy as np
import pytest
from blenders import User
from browser import launched
from knot_pages import opened, page  # noqa: F401 - fixtures
from PIL import Image

import fastgs_blender as fg

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "fireside.safetensors"
KERNELS = Path(__file__).resolve().parents[2] / "build" / "cache"
"""What the other tests have compiled."""
ROOT = os.environ.get("FASTGS_BLENDER_ROOT", "")
"""A folder made by blender_root.sh."""
OUTPUT = Path(os.environ.get("FASTGS_BLENDER_OUTPUT", ""))
"""Where logs, files and screenshots stay."""
IN_BOTH = pytest.mark.parametrize("browser", ["chromium", "firefox-esr"], indirect=True)
"""Marks tests of web pages that run in both browsers."""


def pytest_addoption(parser):
    parser.addoption("--monkey-actions", type=int, default=60, help="how many things the monkey does in any order")
    parser.addoption("--monkey-seed", type=int, default=1, help="another seed, other things in another order")


@pytest.fixture(scope="session")
def newcomer() -> User:
    """Somebody who has just installed Blender."""
    if not ROOT:
        pytest.skip("these tests are started with make test-blender")
    shutil.rmtree(OUTPUT, ignore_errors=True)
    OUTPUT.mkdir(parents=True)
    return User(Path(ROOT), OUTPUT, "home-new")


@pytest.fixture(scope="session")
def user(newcomer) -> User:
    """Somebody who has installed the extension's zip."""
    user = User(newcomer.root, newcomer.folder)
    user.install(Path(os.environ["FASTGS_ZIP"]))
    home = user.folder / user.home
    lend_kernels(home / ".cache" / "fastgs-blender")  # of training
    lend_kernels(next((home / ".config" / "blender").glob("*/extensions")) / ".user" / "user_default" / "fastgs_blender" / "kernels")
    return user


def lend_kernels(folder: Path) -> None:
    """Copy what the other tests have compiled: a Python of the same version finds it there, another compiles for itself."""
    for kernels in KERNELS.glob("kernels-*"):
        shutil.copytree(kernels, folder / kernels.name)


@pytest.fixture(scope="session")
def model(newcomer):
    """The model and the name of its file in the working folder."""
    model = models.knot()
    fg.save(model, newcomer.folder / "knot.safetensors")
    return model, "knot.safetensors"


@pytest.fixture(scope="session")
def example():
    """The model that the extension brings along."""
    return fg.load(EXAMPLE)


@pytest.fixture(scope="session")
def small_model(newcomer):
    """The same of a smaller one."""
    model = models.knot(4_000, seed=5)
    fg.save(model, newcomer.folder / "small.safetensors")
    return model, "small.safetensors"


@pytest.fixture(scope="session")
def browser(request, tmp_path_factory):
    """A browser that opens the pages in its folder, `browser.folder`: the root's, or those that FASTGS_BROWSER names.

    It is Chromium; tests that IN_BOTH marks run in Firefox, too.
    """
    command = getattr(request, "param", "chromium")
    known = Path(ROOT, "usr", "bin", command).exists() if ROOT else command in os.environ.get("FASTGS_BROWSER", "").split()
    if not known:
        pytest.skip(f"{command} is in the root of Debian trixie; elsewhere FASTGS_BROWSER names it")
    if ROOT:
        request.getfixturevalue("newcomer")  # who begins with an empty folder
    folder = OUTPUT / "pages" if ROOT else tmp_path_factory.mktemp("pages")
    folder.mkdir(parents=True, exist_ok=True)
    with launched(command, folder, ROOT) as browser:
        yield browser


def library_camera(facts) -> fg.Camera:
    """The library's camera for what the story `look` says of Blender's."""
    pose = np.array(facts["matrix"])
    width, height = facts["width"], facts["height"]
    return fg.Camera(width, height, facts["focal"], facts["focal"], width / 2, height / 2,
                     np.diag([1.0, -1, -1, 1]) @ np.linalg.inv(pose))


def region_camera(facts) -> fg.Camera:
    """The library's camera for what the story `seen_by` says of a view."""
    p, (_, _, width, height) = np.array(facts["window"]), facts["region"]
    pose = np.diag([1.0, -1, -1, 1]) @ np.array(facts["view"])
    orthographic = p[3, 3] == 1
    centre = p[:2, 3] if orthographic else -p[:2, 2]
    if orthographic:
        pose[2, 3] += 100  # such a view also shows what lies behind its matrix's origin
    return fg.Camera(width, height, width / 2 * p[0, 0], height / 2 * p[1, 1], width / 2 * (1 + centre[0]), height / 2 * (1 - centre[1]),
                     pose, orthographic=bool(orthographic))


@pytest.fixture(scope="session")
def reference():
    """reference(model, camera or its facts, clip frame, crops=()): what the library draws, RGBA premultiplied, 0 .. 1."""
    def draw(model, camera, frame, crops=()):
        camera = camera if isinstance(camera, fg.Camera) else library_camera(camera)
        out = fg.render([(model, np.eye(4), model.clip.t_of_frame(frame), crops)], camera)
        return np.concatenate([out["rgb"], out["alpha"][..., None]], -1)

    return draw


def read_png(path: Path) -> np.ndarray:
    """RGBA [h, w, 4] premultiplied, 0 .. 1."""
    rgba = np.asarray(Image.open(path).convert("RGBA")) / 255.0
    rgba[..., :3] *= rgba[..., 3:]
    return rgba


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    """dB, for pictures in 0 .. 1."""
    return float(-10 * np.log10(max(np.mean((a - b) ** 2), 1e-12)))


def black_behind(rgba: np.ndarray) -> np.ndarray:
    """The sRGB colours [h, w, 3] that Blender shows for premultiplied splats over black: it fades linear light."""
    alpha = rgba[..., 3:]
    straight = np.divide(rgba[..., :3], alpha, out=np.zeros_like(rgba[..., :3]), where=alpha > 0)
    linear = np.where(straight <= 0.04045, straight / 12.92, ((straight + 0.055) / 1.055) ** 2.4) * alpha
    return np.clip(np.where(linear <= 0.0031308, linear * 12.92, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055), 0, 1)
