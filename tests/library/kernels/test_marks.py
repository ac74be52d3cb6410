# SPDX-License-Identifier: GPL-3.0-or-later
"""The marks of the Gaussians that contribute to a picture, which threads write side by side."""
import os
import subprocess
import sys

import pytest

CHILD = """
import mmap, sys
import numpy as np
import fastgs_blender as fg
from fastgs_blender.kernels.cpu import light, splats
from fastgs_blender.util.threads import set_threads
from random_models import random_model

model = random_model(np.random.default_rng(0), 4000)
camera = fg.Camera(160, 120, 150, 150, 80, 60, fg.look_at((0, 0, -4), (0, 0, 0), (0, -1, 0)))
found, own = [], light.mark
def mark(*args):
    own(*args)  # then once more, where nothing may be written
    with open(sys.argv[1], "w+b") as file:
        file.write(args[-1].tobytes())
        file.flush()
        kept = np.frombuffer(mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ), np.bool_)
    found.append(kept.mean())
    own(*args[:-1], splats.plain(kept))
light.mark = mark
set_threads(1)
light.contributing([fg.Instance(model, np.eye(4), 0.0).viewed(camera)], camera)
print(np.mean(found))
"""


@pytest.mark.posix
def test_a_mark_is_never_taken_back(tmp_path):
    """A splat lies in many tiles: a thread that does not see it must not write over what another thread has just written."""
    ran = subprocess.run([sys.executable, "-c", CHILD, str(tmp_path / "marks")], capture_output=True, text=True, check=False,
                         env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)})
    assert ran.returncode == 0, ran.stderr  # a write ends the process
    assert 0.05 < float(ran.stdout) < 0.95
