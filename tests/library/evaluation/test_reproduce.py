# SPDX-License-Identifier: GPL-3.0-or-later
"""benchmarks/reproduce.py: the protocols of three data sets on tiny scenes that lie as each data set does."""
from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from toy_captures import toy_cameras, toy_scene

import fastgs_blender as fg
from fastgs_blender.captures import open_capture

FRAMES = 3
FEW = ["--set", "iterations=3", "--set", "preview_every=0", "--set", "max_gaussians=300", "--no-lpips", "--quiet"]


@pytest.fixture(scope="module")
def reproduce():
    spec = importlib.util.spec_from_file_location("reproduce", Path(__file__).resolve().parents[3] / "benchmarks" / "reproduce.py")
    sys.modules["reproduce"] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    del sys.modules["reproduce"]


def quaternion(rotation):
    """w x y z of a rotation whose angle is under 90 degrees."""
    w = np.sqrt(1 + np.trace(rotation)) / 2
    return [w, *((rotation[[2, 0, 1], [1, 2, 0]] - rotation[[1, 2, 0], [2, 0, 1]]) / (4 * w))]


def picture(model, camera, frame):
    return Image.fromarray(np.uint8(np.clip(fg.render(model, camera, frame / FRAMES)["rgb"], 0, 1) * 255))


def workspaces(folder: Path, cameras: dict, numbers, shift=0.0):
    """colmap_K/sparse/0 of each frame: three points, and the cameras, moved by `shift`."""
    for k in numbers:
        place = folder / f"colmap_{k}" / "sparse" / "0"
        place.mkdir(parents=True)
        lines = [f"{i + 1} PINHOLE {c.width} {c.height} {c.fx} {c.fy} {c.cx} {c.cy}" for i, c in enumerate(cameras.values())]
        (place / "cameras.txt").write_text("\n".join(lines) + "\n")
        rows = [" ".join(map(str, [i + 1, *quaternion(c.world_to_camera[:3, :3]), *(c.world_to_camera[:3, 3] + shift), i + 1,
                                   f"{name}.png"])) + "\n" for i, (name, c) in enumerate(cameras.items())]
        (place / "images.txt").write_text("\n".join(rows) + "\n")
        (place / "points3D.txt").write_text("".join(f"{n} {n / 9} {k / 9} 1.0 200 100 {50 * n} 0.5 1 0 2 0\n" for n in range(3)))


def n3v(folder: Path, frames=FRAMES, shift=0.0):
    """cam00/images/0000.png ..., poses_bounds.npy and the points of each frame."""
    model, cameras = toy_scene(FRAMES), {f"cam{i:02}": c for i, c in enumerate(toy_cameras(3))}
    rows = []
    for name, c in cameras.items():
        (folder / name / "images").mkdir(parents=True)
        for frame in range(frames):
            picture(model, c, frame % FRAMES).save(folder / name / "images" / f"{frame:04}.png")
        right, down, forward, centre = np.linalg.inv(c.world_to_camera)[:3].T
        matrix = np.stack([down, right, -forward, centre, [c.height, c.width, c.fx]], 1)
        rows.append(np.r_[matrix.ravel(), 0.5, 20])
    np.save(folder / "poses_bounds.npy", np.array(rows))
    workspaces(folder, cameras, range(FRAMES), shift)
    return folder


def technicolor(folder: Path):
    """Frames 50 to 102 of Fabien, of which 51 to 100 are published; small, and of one picture for each camera."""
    folder.mkdir(parents=True)
    cameras = {f"{i:02}": c for i, c in zip((0, 1, 10), toy_cameras(3))}
    lines = ["f cx cy ar sk qw qx qy qz tx ty tz"]
    for i in range(16):
        c = cameras.get(f"{i:02}", cameras["00"])
        lines.append(" ".join(map(str, [c.fx, c.cx, c.cy, 1, 0, *quaternion(c.world_to_camera[:3, :3]), *c.world_to_camera[:3, 3]])))
    (folder / "cameras_parameters.txt").write_text("\n".join(lines) + "\n")
    model = toy_scene(FRAMES)
    for name, c in cameras.items():
        for frame in range(50, 103):
            picture(model, c, 0).save(folder / f"Fabien_undist_{frame:05}_{name}.png")
    workspaces(folder, cameras, (51, 52))


def immersive(folder: Path):
    from fastgs_blender.evaluation.film import film

    folder.mkdir(parents=True)
    entries, model = [], toy_scene(FRAMES)
    for name, c in zip(("camera_0001", "camera_0010", "camera_0037", "camera_0040"), toy_cameras(4)):
        with film(folder / f"{name}.mp4", c.width, c.height, 30) as add:
            for frame in range(FRAMES):
                add(np.asarray(picture(model, c, frame)))
        rotation = c.world_to_camera[:3, :3]
        half = np.array(quaternion(rotation))
        angle = 2 * np.arccos(min(half[0], 1.0))
        axis = half[1:] / max(np.linalg.norm(half[1:]), 1e-12) * angle
        entries.append({"name": name, "position": (-rotation.T @ c.world_to_camera[:3, 3]).tolist(), "orientation": axis.tolist(),
                        "focal_length": c.fx, "principal_point": [c.cx, c.cy], "width": c.width, "height": c.height,
                        "radial_distortion": [0.0, 0.0, 0.0], "projection_type": "pinhole"})
    (folder / "models.json").write_text(json.dumps(entries))


def rows_of(reproduce, capsys, *arguments) -> list[dict]:
    assert reproduce.main([*map(str, arguments), *FEW, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_neural_3d_video_with_the_points_of_each_frame(reproduce, tmp_path, capsys, monkeypatch):
    n3v(tmp_path / "data" / "cook_spinach")
    arguments = ["n3v", tmp_path / "data", "--out", tmp_path / "out"]
    loud = [*map(str, arguments), *(option for option in FEW if option != "--quiet"), "--json"]
    assert reproduce.main([*loud]) == 0
    told = capsys.readouterr()
    row, = json.loads(told.out)
    assert told.err.index("training will take about") < told.err.index("cook_spinach: training"), "before it starts"
    assert "3 steps" in told.err and "210 Gaussians at 24 x 18" in told.err
    assert row["scene"] == "cook_spinach" and row["view"] == "cam00"
    assert row["costs"]["megabytes"] == (tmp_path / "out" / "cook_spinach" / "model.safetensors").stat().st_size / 1e6
    report = json.loads((tmp_path / "out" / "cook_spinach" / "report.json").read_text())
    assert row["costs"]["fps"] > 0 and row["costs"]["minutes"] == report["seconds"] / 60
    assert row["measured"]["dssim1_skimage"] > row["measured"]["dssim2"]
    assert row["paper"]["psnr"] == 33.49 and row["stg"]["psnr"] == 33.30 and 5 < row["measured"]["psnr"] < 60
    plan = json.loads((tmp_path / "out" / "cook_spinach" / "run.json").read_text())
    assert plan["settings"]["init"] == "file" and plan["settings"]["preset"] == "paper" and row["gaussians"] <= 9
    assert json.loads((tmp_path / "out" / "reproduce.json").read_text())["rows"] == [row]
    monkeypatch.setattr("fastgs_blender.training.run.launch.launch", lambda *rest: pytest.fail("it was trained again"))
    assert reproduce.main([*loud]) == 0
    told = capsys.readouterr()
    assert json.loads(told.out)[0]["measured"] == row["measured"] and "will take" not in told.err
    assert reproduce.main([*map(str, arguments), *FEW, "--preset", "stg"]) == 2 and "preset = paper" in capsys.readouterr().err
    assert reproduce.main([*map(str, arguments), *FEW]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split("  ")[0] for line in lines if line[0] != " "] == ["scene", "cook_spinach cam00"] and "33.49" in lines[2]


def test_immersive_has_a_row_for_each_view_of_the_paper(reproduce, tmp_path, capsys):
    immersive(tmp_path / "data" / "02_Flames")
    rows = rows_of(reproduce, capsys, "immersive", tmp_path / "data", "--out", tmp_path / "out", "--set", "init=random",
                   "--set", "init_points=60")
    assert [(row["view"], row["paper"]["psnr"]) for row in rows] == [("camera_0010", 30.56), ("camera_0037", 31.54)]
    assert all("psnr" in row["measured"] for row in rows)
    plan = json.loads((tmp_path / "out" / "02_Flames" / "run.json").read_text())
    assert plan["settings"]["activation"] == "none" and plan["settings"]["decode"] == "premultiplied", "STG's configuration of the scene"
    assert plan["settings"]["densify_time"] == "keep", "densify 6 of train_imdist.py, which clones with densify_and_cloneim()"
    first, second = reproduce.table(rows).splitlines()[2:6:3]
    assert first.split()[-3:] == ["146", "363", "40.6"] and second.split()[-3:] == ["-", "-", "-"], "the paper's second table"
    assert reproduce.table(rows).splitlines()[3].split()[-3:] == ["154", "248", "34.2"]


def test_technicolor_trains_on_the_published_frames(reproduce, tmp_path, capsys):
    technicolor(tmp_path / "data" / "Fabien")
    row, = rows_of(reproduce, capsys, "technicolor", tmp_path / "data", "--out", tmp_path / "out", "--preset", "stg",
                    "--set", "segment_frames=0")
    assert row["view"] == "10" and row["paper"] == {}
    plan = json.loads((tmp_path / "out" / "Fabien" / "run.json").read_text())
    assert plan["source"]["frames"] == [1, 51, 1] and plan["settings"]["init"] == "file" and plan["settings"]["motion"] == "polynomial"


def test_long_films_are_cut_into_fragments_as_published(reproduce):
    parts, PROTOCOLS = reproduce.parts, reproduce.PROTOCOLS
    made = parts(PROTOCOLS["n3v"], Path("flame_salmon_1"), 1200, 0, None)
    assert [(p.name, p.frames.start, p.frames.stop) for p in made][::3] == [
        ("flame_salmon_1-1of4", 0, 300), ("flame_salmon_1-4of4", 900, 1200)] and made[0].scene == "flame_salmon"
    assert [p.frames for p in parts(PROTOCOLS["n3v"], Path("sear_steak"), 300, 0, None)] == [None]
    assert [p.frames for p in parts(PROTOCOLS["n3v"], Path("sear_steak"), 1200, 0, slice(0, 5))] == [slice(0, 5)]


def test_points_of_each_frame_belong_to_their_moments_and_to_the_same_cameras(tmp_path):
    folder = n3v(tmp_path / "good")
    points = open_capture(folder).points
    assert len(points) == 9 and sorted(set(points.t)) == pytest.approx([0, 1 / 3, 2 / 3]) and points.xyz[3, 1] == pytest.approx(1 / 9)
    later = open_capture(folder, frames=slice(1, 3)).points
    assert len(later) == 6 and sorted(set(later.t)) == [0, 0.5]
    other = open_capture(n3v(tmp_path / "moved", shift=0.2))
    assert other.points is None and "stand elsewhere" in " ".join(other.notes)


def test_a_folder_without_scenes_is_told(reproduce, tmp_path, capsys):
    assert reproduce.main(["n3v", str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    assert "of a scene" in capsys.readouterr().err
    n3v(tmp_path / "sear_steak", frames=1)
    assert reproduce.main(["n3v", str(tmp_path), "--out", str(tmp_path / "out"), "--scenes", "sear_steak,soup"]) == 2
    assert "the scene soup" in capsys.readouterr().err
