# SPDX-License-Identifier: GPL-3.0-or-later
"""Sequences: folders, patterns and zips of numbered files; their frames, what lies between, memory, and fits to them."""
from __future__ import annotations

import json
import subprocess
import sys
import threading
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.formats import fingerprint, identify
from fastgs_blender.formats.sequences import grouped, title
from fastgs_blender.model import sequence
from fastgs_blender.model.from_frames import one_model

pytestmark = pytest.mark.filterwarnings("ignore::fastgs_blender.LossWarning")
COUNT = 50
SPEED = np.float32([0.5, -0.2, 0.1])


def frame(i: int) -> fg.GaussianModel:
    """The model of frame i: it moves straight, so that what lies between two frames is known."""
    model = random_model(np.random.default_rng(4), COUNT, appearance="sh1", extent=2.0)
    return replace(model, position=model.position + np.float32(i / 10) * SPEED)


def write(folder: Path, numbers, name="take_{:04d}.ply", model=frame) -> Path:
    folder.mkdir(exist_ok=True)
    for number in numbers:
        fg.save(model(number), folder / name.format(number))
    return folder


def place(source, f, **options):
    """The first Gaussian's position at frame f of a source."""
    return source.moment(source.clip.t_of_frame(f), **options)[0].position[0]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write(tmp_path_factory.mktemp("sequence") / "take", range(1, 9))


def test_each_frame_is_its_file_and_between_them_the_gaussians_move(folder):
    source = fg.open_source(folder)
    assert (source.clip.frame_count, source.clip.start_frame, source.clip.free, len(source)) == (8, 1, True, COUNT)
    for f in range(8):
        shown, t = source.moment(source.clip.t_of_frame(f))
        for name, array in fg.load(folder / f"take_{f + 1:04d}.ply").arrays.items():
            np.testing.assert_array_equal(getattr(shown, name), array)
        assert t == 0
    start = place(source, 0)
    np.testing.assert_allclose(place(source, 2.25), start + 0.225 * SPEED, atol=1e-6)
    np.testing.assert_array_equal(place(source, 2.25, hold=True), place(source, 2))
    np.testing.assert_array_equal(place(source, 2.75, hold=True), place(source, 3))
    for beyond, edge in ((-3, 0), (7.5, 7), (99, 7)):
        np.testing.assert_array_equal(place(source, beyond), place(source, edge))


def test_between_frames_whose_gaussians_do_not_match_the_nearer_one_is_shown(tmp_path):
    def shuffled(i):
        return frame(i).take(np.random.default_rng(i).permutation(COUNT))

    for name, model in (("order", shuffled), ("count", lambda i: frame(i).take(np.arange(COUNT - i)))):
        source = fg.open_source(write(tmp_path / name, range(3), model=model))
        for f, nearer in ((0.4, 0), (0.6, 1), (1.5, 2)):
            np.testing.assert_array_equal(place(source, f), place(source, nearer))
        with pytest.raises(fg.FastGSError, match="same Gaussians"):
            one_model(source)


def test_numbers_have_steps_and_gaps(tmp_path):
    source = fg.open_source(write(tmp_path / "steps", (10, 15, 25, 30)))
    assert source.clip.frame_count == 5 and source.clip.start_frame == 10
    np.testing.assert_allclose(place(source, 2), frame(20).position[0], atol=1e-6)
    with pytest.warns(fg.LossWarning, match="1 of 5 frames"):
        fg.open_source(tmp_path / "steps")
    assert fg.open_source(write(tmp_path / "times", (17000000001, 17000000101, 17900000000))).clip.frame_count == 3


def test_paths_and_names(folder, tmp_path):
    assert fg.open_source(folder / "take_####.ply").clip.frame_count == 8
    part = fg.open_source(folder / "take_[0003-0005].ply")
    assert part.clip.frame_count == 3 and part.clip.start_frame == 3
    files = [folder / f"take_{i:04d}.ply" for i in range(1, 9)]
    assert grouped([*files, tmp_path / "other.ply"]) == [folder / "take_####.ply", tmp_path / "other.ply"]
    assert grouped(files[2:5]) == [folder / "take_[0003-0005].ply"]
    assert grouped(files[:1]) == files[:1]
    mixed = [Path(f"/nowhere/{name}") for name in ("cam2_7.spz", "cam2_08.spz", "cam2_a.spz", "walk1.safetensors", "walk2.safetensors")]
    assert [path.name for path in grouped([*files, *mixed])] == ["take_####.ply", "cam2_####.spz", *(path.name for path in mixed[2:])]
    for path, name in ((folder, "take"), (folder / "take_####.ply", "take"), (folder / "####.spz", "take"), (Path("a/b.zip"), "b")):
        assert title(path) == name


def test_capitals_and_other_numbers_make_no_difference(tmp_path):
    """Windows and cameras write names as they like; times in names are no frames' numbers."""
    for i, name in enumerate(("Take_1.PLY", "take_02.ply", "TAKE_3.ply", "take_010.Ply")):
        fg.save(frame(i), tmp_path / "a.ply")
        (tmp_path / "a.ply").rename(tmp_path / name)
    (tmp_path / "._take_4.ply").write_bytes(b"what macOS leaves")
    source = fg.open_source(tmp_path)
    assert source.clip.frame_count == 10 and len(source.at) == 4
    np.testing.assert_array_equal(place(source, 9), frame(3).position[0])
    assert len(fg.open_source(tmp_path / "take_####.ply").at) == 4
    chosen = [tmp_path / name for name in ("Take_1.PLY", "take_02.ply", "TAKE_3.ply")]
    (pattern,) = grouped(chosen)
    assert len(fg.open_source(pattern).at) == 3 and title(pattern).lower() == "take"
    timed = write(tmp_path / "timed", (0,), "f_{:d}_t0.000.ply")
    for i in (1, 2):
        write(timed, (i,), f"f_{{:d}}_t{i / 30:.3f}.ply")
    source = fg.open_source(timed)
    np.testing.assert_array_equal([place(source, f) for f in range(3)], [frame(i).position[0] for i in range(3)])


def test_a_folder_for_each_frame(tmp_path):
    """As trainers that run once a frame leave them, with an earlier iteration beside the last one."""
    for i in range(3):
        for iteration, model in ((7000, frame(9)), (30000, frame(i))):
            there = tmp_path / "run" / f"frame{i:06d}" / "point_cloud" / f"iteration_{iteration}"
            there.mkdir(parents=True)
            fg.save(model, there / "point_cloud.ply")
        (tmp_path / "run" / f"frame{i:06d}" / "cameras.json").write_text("[]")
    with zipfile.ZipFile(tmp_path / "run.zip", "w") as archive:
        for file in sorted((tmp_path / "run").rglob("*.ply")):
            archive.write(file, file.relative_to(tmp_path))
    for path in (tmp_path / "run", tmp_path / "run.zip"):
        source = fg.open_source(path)
        np.testing.assert_array_equal([place(source, f) for f in range(3)], [frame(i).position[0] for i in range(3)])
    for name in ("a", "b", "c"):
        (tmp_path / "run" / name).symlink_to(tmp_path / "run")  # a loop is no endless work
    assert len(fg.open_source(tmp_path / "run").at) == 3
    inside = fg.open_source(tmp_path / "run" / "frame000001")  # two iterations of one model are no clip
    np.testing.assert_array_equal(inside.position, frame(1).position)


def test_sog_in_folders(tmp_path):
    for i in range(2):
        fg.save(frame(i), tmp_path / "packed.sog")
        with zipfile.ZipFile(tmp_path / "packed.sog") as archive:
            archive.extractall(tmp_path / "frames" / f"{i:04d}")
    model = fg.load(tmp_path / "packed.sog")
    one = tmp_path / "frames" / "0001"
    for path in (one, one / "meta.json"):
        np.testing.assert_array_equal(fg.load(path).position, model.position)
    assert fg.open_source(one).provenance["format"] == identify(one).name == "SOG" and fingerprint(one) == fingerprint(one / "meta.json")
    source = fg.open_source(tmp_path / "frames")
    assert len(source.at) == 2
    np.testing.assert_array_equal(source.moment(source.clip.t_of_frame(1))[0].position, model.position)
    (one / "meta.json").write_text('{"a": 1}')
    with pytest.raises(fg.FastGSError, match="numbered"):
        fg.open_source(one)


def test_a_rewritten_frame_is_read_again(folder, tmp_path):
    source = fg.open_source(write(tmp_path / "live", range(3)))
    before = place(source, 1)
    fg.save(frame(9), tmp_path / "live" / "take_0001.ply")
    assert not np.array_equal(place(source, 1), before)


def test_memory_is_bounded_and_the_next_frames_are_read_ahead(monkeypatch):
    """With frames that are computed, and a reader that says which were read."""
    one = frame(0).nbytes
    monkeypatch.setattr(sequence, "cache", sequence.Cache(limit=5 * one))
    made, ready = [], threading.Condition()

    def read(i):
        with ready:
            made.append(i)
            ready.notify_all()
        return frame(i)

    source = fg.Sequence(sequence.FreeClip(40), np.arange(40), read)
    place(source, 0)
    place(source, 1)
    with ready:
        assert ready.wait_for(lambda: {2, 3, 4} <= set(made), 30), made
    for f in range(2, 40):
        place(source, f)
        assert sequence.cache.nbytes() <= 5 * one
    assert source.nbytes == sequence.cache.nbytes()
    with pytest.raises(sequence.NotRead):
        source.moment(0.5, read=False)
    np.testing.assert_array_equal(place(source, 39, read=False), frame(39).position[0])


def test_several_threads_read_a_frame_once():
    made = []
    source = fg.Sequence(sequence.FreeClip(3), np.arange(3), lambda i: made.append(i) or frame(i))
    threads = [threading.Thread(target=place, args=(source, 2)) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert made.count(2) == 1


def test_what_cannot_be_opened_is_said(tmp_path, folder):
    def refused(path, *words, open_=fg.open_source):
        with pytest.raises(fg.FastGSError) as error:
            open_(path)
        assert all(word in str(error.value) for word in (path.name, *words)), error.value

    (tmp_path / "empty").mkdir()
    refused(tmp_path / "empty", "numbered")
    write(write(tmp_path / "two", (1, 2)), (1, 2), "b{:d}.ply")
    refused(tmp_path / "two", "2 sequences", "take_####.ply", "b####.ply")
    refused(tmp_path / "two" / "c_####.ply", "no such files")
    refused(folder, "sequence", "open_source", open_=fg.load)
    moving = random_model(np.random.default_rng(0), 5, basis="cubic", rotation_basis="line", temporal="radial")
    refused(write(tmp_path / "moving", (1, 2), model=lambda i: moving), "over time")
    write(tmp_path / "broken", range(3))
    (tmp_path / "broken" / "take_0001.ply").write_bytes(b"ply\nnonsense")
    source = fg.open_source(tmp_path / "broken")
    with pytest.raises(fg.FastGSError, match=r"take_0001\.ply"):
        place(source, 1)
    np.testing.assert_array_equal(place(source, 2), fg.load(tmp_path / "broken" / "take_0002.ply").position[0])


def test_a_sequence_is_rendered_as_its_frames_are(folder):
    source = fg.open_source(folder)
    camera = fg.Camera(40, 30, 30.0, 30.0, 20.0, 15.0, np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 6], [0, 0, 0, 1]]))
    for f in (0, 5):
        image = fg.render(source, camera, source.clip.t_of_frame(f))["rgb"]
        np.testing.assert_array_equal(image, fg.render(fg.load(folder / f"take_{f + 1:04d}.ply"), camera)["rgb"])


def curved(i: int) -> fg.GaussianModel:
    """Frame i of 20 of a moving, turning, changing cloud."""
    t = i / 20
    model = random_model(np.random.default_rng(4), COUNT, appearance="sh1", extent=2.0)
    turn = model.rotation / np.linalg.norm(model.rotation, axis=1, keepdims=True) + t * np.float32([0.3, 0.1, 0, 0])
    sign = 1 if i % 2 else -1  # exporters do not mind which of the two a quaternion is
    return replace(model, position=model.position + np.float32(np.sin(2 * t)) * SPEED, rotation=sign * turn,
                   features=model.features + np.float32(0.4 * t * t))


def test_one_model_moves_as_the_frames_do(tmp_path):
    source = fg.open_source(write(tmp_path / "curved", range(20), model=curved))
    with pytest.warns(fg.LossWarning, match="RMS error"):
        model = one_model(source)
    assert model.clip == fg.Clip(20, 24.0)
    for i in (0, 7, 19):
        a, b = fg.slice_model(model, i / 20, cull=False), fg.slice_model(curved(i), 0, cull=False)
        np.testing.assert_allclose(a.position, b.position, atol=0.02)
        np.testing.assert_allclose(np.abs(np.sum(a.rotation * b.rotation, 1)), 1, atol=1e-3)
        np.testing.assert_allclose(a.features, b.features, atol=0.03)
        np.testing.assert_allclose(a.scale, b.scale, rtol=1e-5)
        np.testing.assert_allclose(a.opacity, b.opacity, atol=1e-5)


def test_command_line(tmp_path, folder):
    def fastgs(*args):
        done = subprocess.run([sys.executable, "-m", "fastgs_blender", *map(str, args)], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    fastgs("convert", folder, tmp_path / "model.safetensors")
    model = fg.load(tmp_path / "model.safetensors")
    np.testing.assert_allclose(fg.slice_model(model, 3 / 8, cull=False).position, frame(4).position, atol=0.02)
    fastgs("convert", folder / "take_####.ply", tmp_path / "part_##.spz", "--at", "2:3")
    assert (tmp_path / "part_03.spz").is_file()
    facts = json.loads(fastgs("info", folder, "--json"))
    assert facts["clip"]["frame_count"] == 8 and facts["gaussians"] == COUNT


def all_frames(path: Path) -> None:
    source = fg.open_source(path)
    for f in np.arange(0, min(source.clip.frame_count, 4), 0.5):
        model, t = source.moment(source.clip.t_of_frame(f))
        s = fg.slice_model(model, t, cull=False)
        assert all(np.isfinite(v).all() for v in (s.position, s.rotation, s.scale, s.opacity, s.features))
