# SPDX-License-Identifier: GPL-3.0-or-later
"""fastgs info on captures: for people, for scripts, and with everything that is wrong."""
from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from toy_captures import write_capture

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def capture(tmp_path):
    return write_capture(tmp_path / "capture")


def test_for_people(run, capture):
    code, out, _ = run("info", capture)
    lines = dict(line.split(None, 1) for line in out.splitlines())
    assert code == 0
    assert lines["layout"] == "fast-gs capture"
    assert lines["cameras"] == "5: cam00, cam01, cam02, cam03, cam04"
    assert lines["clip"] == "6 frames from 1 at 24 fps, 0.25 s"
    assert lines["pictures"] == "30, 48 x 36"
    assert (lines["masks"], lines["points"]) == ("none", "80")
    assert "held out  cam00" in out and "problem" not in lines


def test_for_scripts(run, capture):
    facts = json.loads(run("info", capture / "cameras.json", "--json")[1])
    assert (facts["layout"], facts["posed"], facts["pictures"], facts["held_out"]) == ("fast-gs capture", True, 30, ["cam00"])
    assert facts["clip"] == {"frame_count": 6, "fps": 24.0, "start_frame": 1, "duration_seconds": 0.25}
    assert facts["views"][0] == {"name": "cam00", "pictures": 6, "held_out": True, "file_width": 48, "file_height": 36, "width": 48,
                                 "height": 36, "lens": "pinhole"}
    assert (facts["masks"], facts["points"], facts["problems"], facts["axes"]) == (None, 80, [], "RDF")


def test_problems_and_masks(run, capture):
    (capture / "cam02" / "0003.png").write_bytes(b"x")
    (capture / "cam03" / "0004.png").unlink()
    for view in range(5):
        (capture / "masks" / f"cam{view:02}").mkdir(parents=True)
        for frame in range(6):
            Image.fromarray(np.zeros((36, 48), np.uint8)).save(capture / "masks" / f"cam{view:02}" / f"{frame + 1:04}.png")
    code, out, _ = run("info", capture)
    assert code == 0 and "masks     mask files" in out
    (note,) = json.loads(run("info", "--json", capture)[1])["notes"]
    assert "2 of 30 pictures" in note and "cam03 lacks the frame 4" in note and str(Path("cam02/0003.png")) in note
    (capture / "masks" / "cam00" / "0001.png").unlink()
    code, out, _ = run("info", capture)
    assert code == 1 and "problem   cam00 has masks" in out, "problems have an exit code of their own"
    assert len(json.loads(run("info", "--json", capture)[1])["problems"]) == 1


def test_a_capture_without_poses(run, capture):
    (capture / "cameras.json").unlink()
    out = run("info", capture)[1]
    assert "folders without poses" in out and "unknown" in out
    assert json.loads(run("info", "--json", capture)[1])["extent"] is None


def test_a_layout_asked_for_by_name(run, capture):
    assert run("info", capture, "--layout", "folders")[1].splitlines()[1].endswith("folders without poses")
    code, _, err = run("info", capture, "--layout", "colmap")
    assert code == 2 and "cameras and images" in err
    assert "no layout 'x'" in run("info", capture, "--layout", "x")[2]


def test_what_is_neither_model_nor_capture(run, tmp_path):
    (tmp_path / "notes.json").write_text("{}")
    for path, words in ((tmp_path, "this is no capture"), (tmp_path / "notes.json", "cannot read")):
        code, _, err = run("info", path)
        assert code == 2 and words in err and err.count("\n") == 1


def test_nothing_heavy_is_imported_for_it(capture):
    program = f"""
import sys
from fastgs_blender import cli
assert cli.main(["info", {str(capture)!r}]) == 0
assert not {{"numba", "torch", "av", "OpenEXR", "pycolmap"}} & set(sys.modules)
"""
    result = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize(("count", "said"), [(9, "cam07, cam08"), (10, "cam07 ... cam09")])
def test_many_cameras_are_named_by_their_ends(run, tmp_path, count, said):
    out = run("info", write_capture(tmp_path / "many", views=count))[1]
    assert said in " ".join(out.split())
