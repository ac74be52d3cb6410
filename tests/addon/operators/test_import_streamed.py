# SPDX-License-Identifier: GPL-3.0-or-later
"""SOG in folders in Blender: objects have the folder's name and size, and the import dialog chooses a level of streamed SOG."""
import json
import zipfile
from pathlib import Path

import bpy
import pytest

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")


@pytest.fixture
def town(make_model, model_file, tmp_path):
    """A folder of streamed SOG with 30 and 12 Gaussians in its two levels, in one chunk each."""
    folder, counts = tmp_path / "old.town", (30, 12)
    for level, n in enumerate(counts):
        with zipfile.ZipFile(model_file(make_model(n), f"{level}.sog")) as archive:
            archive.extractall(folder / f"{level}_0")
    lods = {str(level): {"file": level, "offset": 0, "count": n} for level, n in enumerate(counts)}
    (folder / "lod-meta.json").write_text(json.dumps({
        "version": 1, "lodLevels": 2, "counts": counts, "filenames": ["0_0/meta.json", "1_0/meta.json"], "tree": {"lods": lods}}))
    return folder


def size_of(folder: Path) -> int:
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())


def test_a_folder_of_sog_gives_name_and_size(town, module):
    facts = module("ui.facts")
    (town / "lod-meta.json").unlink()
    folder = town / "0_0"
    for path in (folder, folder / "meta.json"):
        bpy.ops.import_scene.fastgs(filepath=str(path))
        obj = bpy.context.object
        assert obj.name.split(".")[0] == "0_0" and obj.fastgs.gaussian_count == 30
    assert dict(facts.object_facts(obj))["File Size"] == facts.size(size_of(folder))


def test_levels_are_chosen_in_the_dialog(town, module, tmp_path):
    facts, objects = module("ui.facts"), module("scene.objects")
    assert bpy.ops.import_scene.fastgs(filepath=str(town / "lod-meta.json")) == {'FINISHED'}
    fine = bpy.context.object
    assert bpy.ops.import_scene.fastgs(filepath=str(town / "lod-meta.json"), level=1) == {'FINISHED'}
    coarse = bpy.context.object
    assert (fine.name, fine.fastgs.gaussian_count) == ("old.town", 30)
    assert (coarse.name, coarse.fastgs.gaussian_count) == ("old.town level 1", 12)
    assert dict(facts.object_facts(coarse))["File Size"] == facts.size(size_of(town))
    assert objects.error_of(coarse) is None and len(objects.load_model(objects.abspath(coarse))) == 12
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "town.blend"))
    assert [Path(bpy.path.abspath(file.filepath)).is_file() for file in bpy.data.cache_files] == [True] * len(bpy.data.cache_files)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "town.blend"))
    again = bpy.data.objects["old.town level 1"]
    assert len(objects.load_model(objects.abspath(again))) == 12


def test_a_level_is_of_streamed_sog_alone(make_model, model_file):
    """The option is passed over for other files."""
    assert bpy.ops.import_scene.fastgs(filepath=model_file(make_model(7), "m.spz"), level=3) == {'FINISHED'}
    assert bpy.context.object.fastgs.gaussian_count == 7


def test_a_level_that_is_not_there(town, capfd):
    with pytest.raises(RuntimeError, match="levels 0 to 1"):
        bpy.ops.import_scene.fastgs(filepath=str(town / "lod-meta.json"), level=5)
