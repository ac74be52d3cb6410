# SPDX-License-Identifier: GPL-3.0-or-later
"""FrameStore: decoded once, bounded in memory, kept whatever happens."""
from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fastgs_blender.captures import open_capture
from fastgs_blender.captures.layouts.fastgs import write_cameras
from fastgs_blender.captures.pixels import decoding, framefiles
from fastgs_blender.captures.pixels.store import FrameStore
from fastgs_blender.util.errors import FastGSError

ROOT = Path(__file__).resolve().parents[3]
VIEWS, FRAMES, WIDTH, HEIGHT = 3, 8, 40, 30
BYTES = WIDTH * HEIGHT * 3


def right(store, shots):
    """Whether each picture has the shade that the fixture gave it."""
    return all((store.stored(shot) == 40 * int(shot.view[3:]) + 5 * shot.frame).all() for shot in shots)


def test_filled_once_and_reused(capture, cache, monkeypatch):
    told = []
    store = FrameStore(capture, folder=cache)
    assert len(store.missing()) == 24
    store.fill(lambda done, of: told.append((done, of)))
    assert told == [(i, 24) for i in range(25)]
    assert not store.missing() and right(store, capture.shots)

    monkeypatch.setattr(decoding, "decode", None)  # nothing is decoded again, also not for other frames and held-out views
    for again in (open_capture(capture.path), open_capture(capture.path, frames=slice(2, 6), held_out=["cam1"])):
        store = FrameStore(again, folder=cache)
        store.fill()
        assert store.pixels(again.shots[0]).rgb.dtype == np.float32


def test_pixels_on_demand(capture, cache):
    store = FrameStore(capture, folder=cache, whole=True)  # else a plain background is looked for in others
    assert right(store, capture.shots[5:7])
    assert len(store.missing()) == 22


def test_another_scale_or_another_picture_is_decoded_anew(capture, cache):
    FrameStore(capture, folder=cache).fill()
    assert len(FrameStore(open_capture(capture.path, scale=0.5), folder=cache).missing()) == 24
    path = capture.shots[0].image.path
    Image.fromarray(np.full((HEIGHT, WIDTH, 3), 77, np.uint8)).save(path)
    os.utime(path, ns=(1, 1))
    again = open_capture(capture.path)
    store = FrameStore(again, folder=cache)
    assert [shot.image.path for shot in store.missing()] == [path]
    assert (store.stored(again.shots[0]) == 77).all()


def test_memory_stays_within_the_budget(capture, cache):
    store = FrameStore(capture, budget=5 * BYTES, folder=cache)
    for _ in range(2):
        for shot in capture.shots:
            store.pixels(shot)
            assert store.held_bytes <= 5 * BYTES
    assert store.held_bytes == 5 * BYTES
    first = store.stored(capture.shots[-1])
    assert store.stored(capture.shots[-1]) is first  # held
    assert FrameStore(capture, budget=0, folder=cache).pixels(capture.shots[0]).rgb.shape == (HEIGHT, WIDTH, 3)


def test_what_callers_get_is_theirs(capture, cache):
    store = FrameStore(capture, folder=cache)
    store.pixels(capture.shots[3]).rgb[:] = 0.9
    assert right(store, capture.shots[3:4])


MEMORY = """
import resource, sys
import numpy as np
from fastgs_blender.captures import open_capture
from fastgs_blender.captures.pixels.store import FrameStore
capture = open_capture(sys.argv[1])
store = FrameStore(capture, 8 * 2**20, folder=sys.argv[2])
store.fill(threads=1)
store.pixels(capture.shots[0])
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for _ in range(2):
    for shot in capture.shots:
        store.pixels(shot)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


@pytest.mark.posix
def test_resident_memory_stays_within_the_budget_too(tmp_path, cache):
    """Nothing is mapped: 60 MB of frames pass through a budget of 8 MB."""
    side, frames = 512, 80
    write_cameras(tmp_path, [dict(name="a", width=side, height=side, fx=9, fy=9, cx=4, cy=3, world_to_camera=np.eye(4))],
                  frame_count=frames, fps=24)
    (tmp_path / "a").mkdir()
    for i in range(frames):
        Image.fromarray(np.full((side, side, 3), i, np.uint8)).save(tmp_path / "a" / f"{i + 1}.png")
    result = subprocess.run([sys.executable, "-c", MEMORY, str(tmp_path), str(cache)], cwd=ROOT, capture_output=True, text=True, check=True)
    assert int(result.stdout) < 8 * 1024 + 8 * 1024  # the budget, and the float pixels of a few pictures


def test_a_stopped_filling_keeps_what_it_has(capture, cache):
    store = FrameStore(capture, folder=cache)

    def stop(done, of):
        if done == 7:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        store.fill(stop, threads=1)
    assert 7 <= 24 - len(store.missing()) < 24
    store.fill()
    assert right(store, capture.shots)


def test_half_written_and_damaged_files_are_not_believed(capture, cache):
    store = FrameStore(capture, folder=cache)
    store.fill()
    files = sorted(cache.glob("*.frame"))
    files[0].write_bytes(files[0].read_bytes()[:100])
    files[1].write_bytes(b"")
    files[2].write_bytes(bytes(files[2].stat().st_size))
    again = FrameStore(open_capture(capture.path), folder=cache)
    assert len(again.missing()) == 2
    assert right(again, again.capture.shots)
    left = cache / ".fastgs-0123.tmp"
    left.write_bytes(b"of a killed process")
    os.utime(left, (0, 0))
    FrameStore(capture, folder=cache)
    assert not left.exists()


FILL = """
import sys
from fastgs_blender.captures import open_capture
from fastgs_blender.captures.pixels.store import FrameStore
capture = open_capture(sys.argv[1])
store = FrameStore(capture, folder=sys.argv[2])
store.fill()
assert all((store.stored(shot) == 40 * int(shot.view[3:]) + 5 * shot.frame).all() for shot in capture.shots)
"""


def test_two_processes_fill_one_cache(capture, cache):
    running = [subprocess.Popen([sys.executable, "-c", FILL, str(capture.path), str(cache)], cwd=ROOT, stderr=subprocess.PIPE, text=True)
               for _ in range(2)]
    for process in running:
        _, err = process.communicate()
        assert process.returncode == 0, err
    assert len(list(cache.iterdir())) == 24
    assert right(FrameStore(capture, folder=cache), capture.shots)


def test_a_full_disk_is_one_sentence_and_loses_nothing(capture, cache, monkeypatch):
    store = FrameStore(capture, folder=cache)
    written = framefiles.write

    def write(path, array):
        if len(list(cache.glob("*.frame"))) >= 10:
            raise OSError(errno.ENOSPC, "No space left on device")
        written(path, array)

    monkeypatch.setattr(framefiles, "write", write)
    with pytest.raises(FastGSError, match="disk.*full") as error:
        store.fill(threads=1)
    assert str(cache) in str(error.value) and "FASTGS_CACHE_DIR" in str(error.value)
    monkeypatch.undo()
    assert len(store.missing()) == 14
    store.fill()
    assert right(store, capture.shots)


def test_a_disk_that_will_not_do_is_told_before_decoding(capture, cache, monkeypatch):
    store = FrameStore(capture, folder=cache)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: shutil._ntuple_diskusage(10**9, 10**9, 10**6))
    with pytest.raises(FastGSError, match=r"2\d\d MB.*1 MB"):
        store.fill()
    assert not list(cache.glob("*.frame"))


def test_other_caches_go_after_a_month(capture, tmp_path, monkeypatch):
    monkeypatch.setenv("FASTGS_CACHE_DIR", str(tmp_path / "caches"))
    folder = framefiles.default_folder(capture)
    old, young = folder.with_name("old"), folder.with_name("young")
    for other in (old, young):
        other.mkdir(parents=True)
        (other / "x.frame").write_bytes(b"x")
    os.utime(old, (0, 0))
    FrameStore(capture).fill()
    assert not old.exists() and young.exists() and len(list(folder.iterdir())) == 24


def folders(capture, tmp_path, monkeypatch, frames: float, **opened):
    """The capture's own cache folder where all caches may have that many of its frames, and others of eight frames: days since opened."""
    monkeypatch.setenv("FASTGS_CACHE_DIR", str(tmp_path / "caches"))
    monkeypatch.setenv("FASTGS_CACHE_GB", repr(frames * (BYTES + framefiles.HEADER) / 1e9))
    own = framefiles.default_folder(capture)
    for name, days in opened.items():
        own.with_name(name).mkdir(parents=True)
        (own.with_name(name) / "x.frame").write_bytes(bytes(8 * (BYTES + framefiles.HEADER)))
        os.utime(own.with_name(name), (time.time() - 86400 * days,) * 2)
    return own


def test_the_longest_unused_caches_make_room(capture, tmp_path, monkeypatch):
    own = folders(capture, tmp_path, monkeypatch, 40, last_week=7, two_days=2, today=0.5)
    FrameStore(capture).fill()
    assert {path.name for path in own.parent.iterdir()} == {own.name, "two_days", "today"} and len(list(own.iterdir())) == 24


def test_what_finds_no_room_is_decoded_each_time(capture, tmp_path, monkeypatch):
    own = folders(capture, tmp_path, monkeypatch, 18, two_days=2, today=0.5)
    store = FrameStore(capture)
    store.fill()
    assert len(store.beyond) == 14 and len(list(own.iterdir())) == 10 and not own.with_name("two_days").exists()
    kept = {path.name for path in own.iterdir()}
    for other in (store, FrameStore(capture, budget=0)):  # another process of the same training has not filled it
        assert right(other, capture.shots) and {path.name for path in own.iterdir()} == kept
    again = FrameStore(capture)
    again.fill()
    assert again.beyond == store.beyond and {path.name for path in own.iterdir()} == kept


def test_frames_that_are_wanted_now_take_the_place_of_those_used_longest_ago(capture, tmp_path, monkeypatch):
    """As segments of a long capture do, one after the other; frames of no segment that is trained are on disk for long."""
    own, store = folders(capture, tmp_path, monkeypatch, 12.5), FrameStore(capture)
    ordered = [capture.shots[k:k + 6] for k in range(0, 24, 6)]
    for number, part in enumerate(ordered):
        store.fill(shots=part)
        for path in own.iterdir():  # files of one moment are told apart by the order of their segments
            if path.stat().st_mtime > time.time() - 1000:
                os.utime(path, (time.time() - 9000 + number,) * 2)
        assert not store.missing(part) and not store.beyond and len(list(own.iterdir())) <= 12
        assert not number or not store.missing(ordered[number - 1])
    store.fill(shots=ordered[2])  # used again, so those after it go first
    store.fill(shots=ordered[0])
    assert not store.missing(ordered[2]) and len(store.missing(ordered[3])) == 6
    store.fill()
    assert len(store.beyond) == 12 and right(store, capture.shots)


def test_frames_of_other_scales_make_room(capture, tmp_path, monkeypatch):
    own = folders(capture, tmp_path, monkeypatch, 26)
    half = FrameStore(open_capture(capture.path, scale=0.5))
    half.fill()
    for path in own.iterdir():
        os.utime(path, (0, 0))
    FrameStore(capture).fill()
    assert len(list(own.glob("*.frame"))) < 48 and not FrameStore(capture).missing()


def test_a_size_of_the_cache_that_is_no_number(capture, tmp_path, monkeypatch):
    monkeypatch.setenv("FASTGS_CACHE_DIR", str(tmp_path))
    for text in ("much", "-1", "nan"):
        monkeypatch.setenv("FASTGS_CACHE_GB", text)
        with pytest.raises(FastGSError, match="FASTGS_CACHE_GB"):
            FrameStore(capture).fill()


def test_cameras_json_written_by_us_is_plain_json(capture):
    values = json.loads((capture.path / "cameras.json").read_text())
    assert (values["format"], values["version"], values["frame_count"]) == ("fast-gs capture", 1, FRAMES)
