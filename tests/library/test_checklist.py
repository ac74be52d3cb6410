# SPDX-License-Identifier: GPL-3.0-or-later
"""A moderator's checklist of the zip for Blender's store: ours passes, and each rule finds what breaks it."""
from __future__ import annotations

import importlib
import importlib.util
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def checklist():
    """tools/checklist.py"""
    if importlib.util.find_spec("bpy") is None:
        pytest.skip("the extension tool comes with bpy, which is not installed")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "tools")
        yield importlib.import_module("checklist")


@pytest.fixture(scope="module")
def built(checklist, tmp_path_factory):
    """The zip for the store, without wheels."""
    return checklist.build_extension.build("", [], tmp_path_factory.mktemp("zips"), store=True)


FEW = {"__init__.py", "blender_manifest.toml", "LICENSE", "sbom.cdx.json", "examples/LICENSE.txt", "scene/time.py",
       "operators/maintenance.py"}


@pytest.fixture
def spoilt(built, tmp_path):
    """spoilt(changes, names=FEW): the zip with these of its files, all where it is empty, with changes: name to (old, new) or a text."""
    def make(changes, names=FEW):
        path = tmp_path / built.name
        with zipfile.ZipFile(built) as before, zipfile.ZipFile(path, "w") as after:
            texts = {name: before.read(name) for name in before.namelist() if name in names or not names}
            for name, change in changes.items():
                texts[name] = change.encode() if isinstance(change, str) else texts[name].replace(*(part.encode() for part in change))
            for name, text in texts.items():
                after.writestr(name, text)
        return path

    return make


@pytest.mark.slow
def test_our_zip_passes(checklist, built, capsys):
    assert checklist.main([str(built)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1 + len(checklist.RULES) and all(line.startswith("  yes") for line in lines[1:])
    shown = (ROOT / "docs" / "inside.md").read_text("utf-8")
    assert not [rule.__doc__ for rule in checklist.RULES if f"* **yes**: {rule.__doc__}\n" not in shown]


MODULE = "# SPDX-License-Identifier: GPL-3.0-or-later\n"


@pytest.mark.parametrize(("rule", "changes", "named"), [
    ("valid", {"blender_manifest.toml": ("4D Gaussians", "4D Gaussians.")}, "tagline"),
    ("named", {"blender_manifest.toml": ('name = "FAST-GS"', 'name = "Blender GS"')}, "Blender GS"),
    ("plain", {"docs/a.png": ""}, "docs/a.png"), ("plain", {"scene/.hidden": ""}, "scene/.hidden"),
    ("portable", {"scene/aux.py": MODULE}, "scene/aux.py"), ("portable", {"scene/Time.py": MODULE}, "scene/time.py"),
    ("readable", {"scene/x.py": MODULE + "exec('1')"}, "scene/x.py:2 exec()"),
    ("licensed", {"scene/x.py": "1"}, "scene/x.py"),
    ("credited", {"wheels/tqdm-4.70.1-py3-none-any.whl": ""}, "2013 Noam Yorav-Raphael (tqdm)"),
    ("credited", {"examples/cameras.json": "[]"}, "examples/cameras.json"),
    ("licensed", {"scene/x.js": "1"}, "scene/x.js"),
    ("unmodified", {"wheels/tqdm-4.70.1-py3-none-any.whl": ""}, "wheels/tqdm-4.70.1-py3-none-any.whl"),
    ("permitted", {"blender_manifest.toml": ('clipboard = "', 'camera = "')}, "camera"),
    ("permitted", {"scene/x.py": MODULE + "import http.client"}, "network"),
    ("self_contained", {"scene/x.py": MODULE + "RUN = ['-m', 'pip']"}, "scene/x.py calls pip"),
    ("self_contained", {"scene/x.py": MODULE + "from urllib import request"}, "urllib.request"),
    ("separate", {"scene/x.py": MODULE + "from scene.time import x"}, "scene.time"),
    ("separate", {"scene/x.py": MODULE + "import sys\nsys.path.append('x')"}, "scene/x.py:3 sys.path"),
    ("beside_itself", {"scene/x.py": MODULE + "FOLDER = __file__"}, "scene/x.py"),
])
def test_what_breaks_a_rule_is_named(checklist, spoilt, rule, changes, named):
    assert not getattr(checklist, rule)(checklist.Zip(spoilt({})))
    found = getattr(checklist, rule)(checklist.Zip(spoilt(changes)))
    assert any(named in each for each in found), found


@pytest.mark.slow
def test_what_an_extension_does_in_blender_is_watched(checklist, spoilt):
    """It writes beside itself and into the user's folder, asks the network, and leaves a handler and a property behind."""
    rogue = """import socket, contextlib, pathlib, bpy
@bpy.app.handlers.persistent
def _rogue(scene, *_): pass
def register_more():
    pathlib.Path(__file__).with_name("cache.txt").write_text("x")
    pathlib.Path(bpy.utils.resource_path('USER'), "beside.txt").write_text("x")
    bpy.app.handlers.load_post.append(_rogue)
    bpy.types.Light.fastgs = bpy.props.IntProperty()
    with contextlib.suppress(OSError):
        socket.create_connection(("127.0.0.1", 9), 0.1)
def register():
    register_more()
"""
    path = spoilt({"__init__.py": ("def register():\n", rogue)}, ())
    found = "\n".join(checklist.behaves(checklist.Zip(path)))
    for words in ("beside.txt", "handler", "Light.fastgs", "127.0.0.1", "changed its own files"):
        assert words in found


@pytest.mark.slow
def test_the_code_of_a_zip_for_another_system_is_tried(checklist, spoilt):
    other = next(platform for system, platform in checklist.HERE.items() if system != sys.platform)
    lines = f'platforms = ["{other}"]\nwheels = [\n  "./wheels/a-1-py3-none-any.whl",\n]\n\n[permissions]'
    assert not checklist.behaves(checklist.Zip(spoilt({"blender_manifest.toml": ("[permissions]", lines)}, ())))
