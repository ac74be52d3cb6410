# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender as a Python module, with this working copy enabled as the extension that users install."""
from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from importlib import import_module
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ADDON = "bl_ext.user_default.fastgs_blender"


def enable_addon():
    """Enable the extension in a user folder of its own, which goes when the process ends; returns module("scene.time").

    To be called before bpy is imported for the first time.
    """
    user = Path(tempfile.mkdtemp(prefix="fastgs-"))
    atexit.register(shutil.rmtree, user, ignore_errors=True)
    os.environ["BLENDER_USER_RESOURCES"] = str(user)
    folder = user / "extensions" / "user_default"
    folder.mkdir(parents=True)
    (folder / "fastgs_blender").symlink_to(ROOT, target_is_directory=True)
    import bpy  # noqa: F401, I001  first, because it puts addon_utils on the path
    import addon_utils

    if addon_utils.enable(ADDON, default_set=True) is None:
        raise SystemExit("The extension could not be enabled; the reason stands above.")
    return lambda name: import_module(f"{ADDON}.{name}")


def set_image_output(settings, file_format: str = 'PNG') -> None:
    """Let a scene's image settings write still images; Blender 5 asks for the kind of media first."""
    if hasattr(settings, "media_type"):
        settings.media_type = 'IMAGE'
    settings.file_format = file_format
