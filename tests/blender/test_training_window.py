# SPDX-License-Identifier: GPL-3.0-or-later
"""Training from Blender's window.  The Blenders here have no torch: the environment that runs these tests lends them its Python."""
from __future__ import annotations

import sys
import sysconfig
from pathlib import Path

import pytest
from blenders import Failed
from conftest import lend_kernels, psnr, read_png

pytestmark = pytest.mark.newest  # training is the same in all; its panel is in tools_window.panels, which runs in both
BASE, ENVIRONMENT, KERNELS = "training-base", "training-environment", "training-kernels"
"""Folders in the working folder: the Python that is lent, an environment of it with what is installed here, its compiled kernels."""


@pytest.fixture(scope="module")
def environment(user):
    """The name of an environment's folder that has torch, as a user has it somewhere on the disk."""
    packages = sysconfig.get_path("purelib")
    name = f"python{sys.version_info[0]}.{sys.version_info[1]}"
    program = Path(sys.base_prefix, "bin", name)
    if not program.exists():
        pytest.skip(f"the training environment cannot be lent: there is no {program}")
    place = user.folder / ENVIRONMENT
    inside = place / "lib" / name / "site-packages"
    for folder in (user.folder / BASE, place / "bin", inside):
        folder.mkdir(parents=True, exist_ok=True)
    lend_kernels(user.folder / KERNELS)
    (place / "pyvenv.cfg").write_text(f"home = /mnt/{BASE}/bin\ninclude-system-site-packages = false\n")
    (place / "bin" / name).symlink_to(f"/mnt/{BASE}/bin/{name}")
    start = place / "bin" / "python"
    start.write_text(f'#!/bin/sh\nLD_LIBRARY_PATH=/mnt/{BASE}/lib exec /mnt/{ENVIRONMENT}/bin/{name} "$@"\n')
    start.chmod(0o755)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FASTGS_BINDS", f"{sys.base_prefix}={BASE}\n{packages}={inside.relative_to(user.folder)}")
        try:
            user.run(f"/mnt/{ENVIRONMENT}/bin/python", "-c", "import torch, numba")
        except Failed as reason:
            pytest.skip(f"the training environment cannot be lent to this Blender: {str(reason).splitlines()[-1]}")
        yield ENVIRONMENT


def test_from_the_open_scene_to_a_rendered_shot(user, environment):
    facts = user.story("training_window.from_scene_to_shot", window=True, screen="1280x1000",  # all of a finished run below the panels
                       environment=f"/mnt/{environment}", cache=f"/mnt/{KERNELS}")
    assert facts["python"] == f"/mnt/{environment}/bin/python"
    assert facts["kinds"][-2:] == ['TRAINING', 'FINISHED'] and any("left" in line for line in facts["lines"])
    assert "Held-out PSNR" in facts["report"] and "8 cameras, 3 frames, 160 x 120" in facts["checked"]
    done, whole = facts["filming"]
    assert 0 < done < whole == 24 and facts["turned"], "Runs counts the pictures, and the view turns while they are made"
    assert facts["seen"], "the model so far came while training went on"
    assert facts["hidden"] == ["Cylinder", "Suzanne"]
    again = facts["again"]
    assert again["another"] and again["kinds"][0] != 'FINISHED' and again["kinds"][-1] == 'FINISHED', again
    assert again["steps"] == 60 and again["listed"] == [1, 0], "the run that was there is replaced; X asks before it takes one off the list"
    truth, found = (read_png(user.folder / f"toy-{name}.png")[..., :3] for name in ("truth", "model"))
    print("F12 of the model against F12 of the scene:", psnr(found, truth), "dB")
    assert psnr(found, truth) > 20  # the world alone is at 16
