# SPDX-License-Identifier: GPL-3.0-or-later
"""An installed extension is enabled, used and disabled in Blender as a module, and watched: for tools/checklist.py.

    python tools/tried.py FOLDER

FOLDER/user holds Blender's user folder with the extension in it.  Prints a line that begins with NO for each thing that it must not do.
"""
from __future__ import annotations

import os
import sys
from functools import partial
from pathlib import Path

ADDON = "bl_ext.user_default.fastgs_blender"
WRITING = {"os.mkdir": 0, "os.rename": 1, "os.remove": 0, "os.rmdir": 0, "os.truncate": 0, "os.link": 1, "os.symlink": 1}
"""Audit events that change files, and which of their arguments names the file."""
FLAGS = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND


class Watch:
    """Python's audit hook: what is asked of the network, and the files that are written."""

    def __init__(self):
        self.network, self.written = set(), set()
        sys.addaudithook(self)

    def __call__(self, event: str, arguments: tuple) -> None:
        if event.startswith(("socket.connect", "socket.getaddrinfo", "socket.bind", "socket.sendto", "urllib.Request")):
            self.network.add(f"{event} {arguments[1:] if event.startswith('socket.connect') else arguments[:2]}")
        elif event in WRITING or (event == "open" and isinstance(arguments[2], int) and arguments[2] & FLAGS):
            path = arguments[WRITING.get(event, 0)]
            if isinstance(path, str) and os.path.isabs(path):  # others lie in the working folder, which is looked at in the end
                self.written.add(path)


def use(bpy, asked: Path) -> None:
    """What a newcomer does: the example, a frame, a saved file, a report."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.fastgs.import_example()
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 32, 24, 100
    scene.render.filepath = str(asked / "frame.png")
    bpy.ops.render.render(write_still=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(asked / "scene.blend"))
    bpy.ops.fastgs.copy_diagnostics()


def registered(bpy) -> dict[str, set]:
    """What can be left behind: classes, handlers, properties of Blender's types, draw functions of its menus and panels."""
    kinds = [kind for kind in map(partial(getattr, bpy.types), dir(bpy.types)) if isinstance(kind, type)]
    handlers = {f"{name}: {function.__module__}" for name in dir(bpy.app.handlers) for function in _list(bpy.app.handlers, name)
                if "fastgs" in getattr(function, "__module__", "")}
    return {"class": {kind.__name__ for kind in kinds if "FASTGS" in kind.__name__}, "handler": handlers,
            "property": {f"{kind.__name__}.fastgs" for kind in kinds if hasattr(kind, "bl_rna") and "fastgs" in kind.bl_rna.properties},
            "draw function": {kind.__name__ for kind in kinds for function in getattr(getattr(kind, "draw", None), "_draw_funcs", ())
                              if "fastgs" in function.__module__}}


def _list(owner, name):
    value = getattr(owner, name)
    return value if isinstance(value, list) else ()


def contents(folder: Path) -> dict[str, tuple]:
    """File -> size and time, of all in a folder."""
    return {str(path): (path.stat().st_size, path.stat().st_mtime_ns) for path in folder.rglob("*") if path.is_file()}


def main(folder: Path) -> None:
    sys.dont_write_bytecode = True
    user, asked = folder / "user", folder / "asked"
    asked.mkdir()
    os.environ["BLENDER_USER_RESOURCES"] = str(user)
    os.environ["TMPDIR"] = str(folder / "temporary")
    (folder / "temporary").mkdir()
    watch = Watch()
    import bpy  # noqa: I001  first, because it puts addon_utils on the path
    import addon_utils

    home = user / "extensions" / ADDON.split(".")[1] / ADDON.split(".")[2]
    before, shipped = registered(bpy), contents(home)
    watch.written.clear()
    for again in False, True:
        if addon_utils.enable(ADDON, default_set=True) is None:
            print("NO it cannot be enabled")
            return
        if not again:
            use(bpy, asked)
        own = Path(bpy.utils.extension_path_user(ADDON))
        addon_utils.disable(ADDON, default_set=True)
    for kind, left in registered(bpy).items():
        for name in sorted(left - before[kind]):
            print(f"NO a {kind} is left behind: {name}")
    for request in sorted(watch.network):
        print(f"NO it asked the network: {request}")
    allowed = [own, asked, folder / "temporary", Path(os.devnull), home.parents[1]]  # into the last, Blender installs the wheels
    allowed += [Path(chosen) for chosen in [os.environ.get("FASTGS_CACHE_DIR")] if chosen]
    for path in sorted(watch.written):
        if not any(Path(path).is_relative_to(place) or place.is_relative_to(path) for place in allowed):  # or a folder that leads to one
            print(f"NO it wrote {path}")
    for path in folder.iterdir():
        if path not in (user, asked, folder / "temporary"):
            print(f"NO it wrote {path} where it was started")
    if contents(home) != shipped:
        print("NO it changed its own files")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
