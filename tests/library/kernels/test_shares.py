# SPDX-License-Identifier: GPL-3.0-or-later
"""The shares that Gaussians have of a picture's pixels, which threads write side by side."""
import os
import subprocess
import sys

import numpy as np
import pytest
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.kernels.cpu.light import BESIDE, contributing
from fastgs_blender.rendering.layout import Layout
from fastgs_blender.rendering.quantities import Quantity
from fastgs_blender.util.backends import load_backend

CHILD = """
import mmap, sys
import numpy as np
import fastgs_blender as fg
from fastgs_blender.kernels.cpu import light, splats
from fastgs_blender.util.threads import set_threads
from random_models import random_model

model = random_model(np.random.default_rng(0), 4000)
camera = fg.Camera(160, 120, 150, 150, 80, 60, fg.look_at((0, 0, -4), (0, 0, 0), (0, -1, 0)))
found, own = [], light.weigh
def weigh(*args):
    own(*args)  # then once more, where nothing may be written
    with open(sys.argv[1], "w+b") as file:
        file.write(args[-1].tobytes())
        file.flush()
        kept = np.frombuffer(mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ), np.float32)
    found.append((kept > 0).mean())
    own(*args[:-1], splats.plain(kept))
light.weigh = weigh
set_threads(1)
light.contributing([fg.Instance(model, np.eye(4), 0.0).viewed(camera)], camera)
print(np.mean(found))
"""


@pytest.mark.posix
def test_a_share_is_never_lost(tmp_path):
    """A splat lies in many tiles: a thread that does not see it must not write over what another thread has just written."""
    ran = subprocess.run([sys.executable, "-c", CHILD, str(tmp_path / "marks")], capture_output=True, text=True, check=False,
                         env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)})
    assert ran.returncode == 0, ran.stderr  # a write ends the process
    assert 0.05 < float(ran.stdout) < 0.95


def test_shares_are_the_largest_weights_in_a_picture():
    """As the oracle blends: a channel for each Gaussian holds its weight in each pixel, also in those just beside the picture."""
    count, more = 60, BESIDE - 1
    model = random_model(np.random.default_rng(1), count)
    camera = fg.Camera(60, 44, 50, 50, 30, 22, fg.look_at((0, 0, -4), (0, 0, 0), (0, -1, 0)))
    wider = fg.Camera(60 + 2 * more, 44 + 2 * more, 50, 50, 30 + more, 22 + more, camera.world_to_camera)
    seen = fg.Instance(model, np.eye(4), 0.0).viewed(wider)
    layout = Layout([seen], False, {"own": Quantity(count, lambda shown: np.eye(count)[shown.index])})
    weights = load_backend("reference").draw([seen], wider, layout, (), lambda share: None).sums["own"].max((0, 1))
    (index, shares), = contributing([fg.Instance(model, np.eye(4), 0.0).viewed(camera)], camera)
    found = np.zeros(count)
    found[index] = shares
    np.testing.assert_allclose(found, weights, atol=2e-5)
    assert (0 < weights[weights > 0].min() < 0.02) and weights.max() > 0.3
