# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's asset library: its effects as node groups in the asset browser and in *Add Modifier*.

The library is a .blend in the extension's own folder of the user, written by the Blender that is to read it: files of one release
cannot be opened by all others.  It is listed among the asset libraries of the preferences as long as the extension is enabled.
"""
import logging
from pathlib import Path

import bpy

from .. import settings
from . import effects

log = logging.getLogger(__name__)

NAME = "FAST-GS"
"""Of the library, in the preferences and in asset browsers."""
CATALOG = "5d2c1c2e-7f0d-4c53-9a0b-6b0c4f2f51d4"
"""Of the effects, as asset catalogs name themselves."""
CATALOGS = f"""# This is an Asset Catalog Definition file for Blender.

VERSION 1

{CATALOG}:Gaussian Splats:Gaussian Splats
"""


def folder() -> Path:
    """Where the library lies."""
    return Path(bpy.utils.extension_path_user(settings.EXTENSION, path="assets", create=True))


def file() -> Path:
    """The library's .blend: of this release of Blender and of the effects."""
    return folder() / f"effects-{effects.VERSION}-{'.'.join(map(str, bpy.app.version))}.blend"


def write(path: Path) -> None:
    """Write the effects as assets.  What the open file holds stays as it is."""
    here = {effect.name: bpy.data.node_groups.get(effect.name) for effect in effects.EFFECTS.values()}
    for name, tree in here.items():
        if tree is not None:
            tree.name = f".{name} aside"
    made = []
    try:
        for effect in effects.EFFECTS.values():
            tree = effects.build(effect)
            made.append(tree)
            tree.asset_mark()
            tree.asset_data.catalog_id, tree.asset_data.description = CATALOG, effect.description
            tree.asset_data.author, tree.asset_data.license = "FAST-GS", "CC0-1.0"
        aside = path.with_name(f"{path.name}.part")
        bpy.data.libraries.write(str(aside), set(made), fake_user=True, compress=True)
        aside.replace(path)
        (path.parent / "blender_assets.cats.txt").write_text(CATALOGS, encoding="utf-8")
    finally:
        for tree in made:
            bpy.data.node_groups.remove(tree)
        for name, tree in here.items():
            if tree is not None:
                tree.name = name


def ensure() -> None:
    """Write the library where it is missing or old, and list it in the preferences."""
    path = file()
    try:
        if not path.exists():
            for old in path.parent.glob("effects-*.blend*"):
                old.unlink()
            write(path)
        libraries = bpy.context.preferences.filepaths.asset_libraries
        if _ours() is None:
            libraries.new(name=NAME, directory=str(path.parent))
    except (OSError, RuntimeError) as error:
        log.warning("The library of effects cannot be made (%s); Add Effect works without it.", error)


def _ours():
    here = folder()
    return next((each for each in bpy.context.preferences.filepaths.asset_libraries if Path(each.path) == here), None)


def register():
    if not bpy.app.background:  # while Blender starts, its data cannot be written
        bpy.app.timers.register(ensure, first_interval=0.1, persistent=True)


def unregister():
    if bpy.app.timers.is_registered(ensure):
        bpy.app.timers.unregister(ensure)
    try:
        ours = _ours()
    except ValueError:  # not loaded as an extension
        return
    if ours is not None:
        bpy.context.preferences.filepaths.asset_libraries.remove(ours)
