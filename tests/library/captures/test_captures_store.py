# SPDX-License-Identifier: GPL-3.0-or-later
"""FrameStore: decoded once, bounded in memory, kept whatever happens; and the list of what is wrong with a capture."""
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
from fastgs_blender.captures.pixels.checks import check, problems
from fastgs_blender.captures.pixels.store import FrameStore
from fastgs_blender.util.errors import FastGSError

ROOT = Path(__file__).resolve().parents[3]
VIEWS, FRAMES, WIDTH, HEIGHT = 3, 8, 40, 30
BYTES = WIDTH * HEIGHT * 3


def shade(view: int, frame: int) -> int:
    return 40 * view + 5 * frame


@pytest.fixture
def capture(tmp_path):
    """Pictures of one shade each."""
    folder = tmp_path / "capture"
    folder.mkdir()
    write_cameras(folder, [dict(name=f"cam{i}", width=WIDTH, height=HEIGHT, fx=40, fy=40, cx=20, cy=15, world_to_camera=np.eye(4))
                           for i in range(VIEWS)], frame_count=FRAMES, fps=24)
    for i in range(VIEWS):
        (folder / f"cam{i}").mkdir()
        for frame in range(FRAMES):
            Image.fromarray(np.full((HEIGHT, WIDTH, 3), shade(i, frame), np.uint8)).save(folder / f"cam{i}" / f"{frame + 1:04}.png")
    return open_capture(folder)


@pytest.fixture
def cache(tmp_path):
    return tmp_path / "cache"


def right(store, shots):
    return all((store.stored(shot) == shade(int(shot.view[3:]), shot.frame)).all() for shot in shots)


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
    store = FrameStore(capture, folder=cache)
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


@pytest.mark.skipif(sys.platform != "linux", reason="counts kilobytes as Linux does")
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
    with pytest.raises(FastGSError, match="the disk is full") as error:
        store.fill(threads=1)
    assert str(cache) in str(error.value) and "FASTGS_CACHE_DIR" in str(error.value)
    monkeypatch.undo()
    assert len(store.missing()) == 14
    store.fill()
    assert right(store, capture.shots)


def test_a_disk_that_will_not_do_is_told_before_decoding(capture, cache, monkeypatch):
    store = FrameStore(capture, folder=cache)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: shutil._ntuple_diskusage(10**9, 10**9, 10**6))
    with pytest.raises(FastGSError, match=r"need 2\d\d MB there, and 1 MB are free"):
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


# What is wrong with a capture


def test_nothing_wrong(capture):
    assert problems(capture) == []
    check(capture)


def test_everything_wrong_is_told_at_once(capture):
    folder = capture.path
    (folder / "cam0" / "0003.png").unlink()
    (folder / "cam0" / "0004.png").unlink()
    (folder / "cam1" / "0002.png").write_bytes(b"")
    (folder / "cam1" / "0005.png").write_bytes(b"no picture")
    Image.fromarray(np.zeros((20, 20, 3), np.uint8)).save(folder / "cam2" / "0006.png")
    (folder / "masks" / "cam0").mkdir(parents=True)
    Image.fromarray(np.zeros((9, 9), np.uint8)).save(folder / "masks" / "cam0" / "0001.png")
    found = "\n".join(problems(open_capture(folder)))
    for words in ("cam0 lacks 2 frames: 3-4", "0002.png: the picture is empty",
                  "0005.png: the picture cannot be read (it is no PNG or JPEG)",
                  "cam2 has pictures of 20 x 20 pixels where its calibration is for 40 x 30 (frames 6)", "masks of 9 x 9",
                  "cam0 has masks for some of its frames only"):
        assert words in found
    with pytest.raises(FastGSError, match="there are 6 problems") as error:
        check(open_capture(folder))
    assert str(error.value).startswith(str(folder)) and "\n" not in str(error.value)
    assert not open_capture(folder, frames=slice(6, None)).faults  # the part asked for is whole


def test_many_problems_are_not_all_listed(capture):
    for shot in capture.shots[:20]:
        shot.image.path.write_bytes(b"x")
    with pytest.raises(FastGSError, match="and 8 more"):
        check(open_capture(capture.path))


def test_a_picture_whose_end_is_missing_is_found_while_filling(capture, cache):
    path = capture.shots[4].image.path
    rng = np.random.default_rng(0)
    Image.fromarray(rng.integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)).save(path)
    path.write_bytes(path.read_bytes()[:900])
    damaged = open_capture(capture.path)
    assert not problems(damaged)
    store = FrameStore(damaged, folder=cache)
    with pytest.raises(FastGSError, match=path.name) as error:
        store.fill()
    assert "there is a problem" in str(error.value)
    assert store.missing() == [damaged.shots[4]]


def test_a_whole_camera_that_is_missing(capture):
    shutil.rmtree(capture.path / "cam1")
    assert problems(open_capture(capture.path)) == ["cam1 lacks 8 frames: 1-8"]


def write_videos(folder, *videos):
    """Films of 32 x 32 pixels: (name, rate, number of frames) each."""
    av = pytest.importorskip("av")
    for name, rate, count in videos:
        with av.open(str(folder / f"{name}.mp4"), "w") as container:
            stream = container.add_stream("mpeg4", rate=rate)
            stream.width, stream.height = 32, 32
            for _ in range(count):
                container.mux(stream.encode(av.VideoFrame(32, 32, "yuv420p")))
            container.mux(stream.encode(None))


def test_videos_of_different_length_and_rate(tmp_path):
    write_videos(tmp_path, ("a", 25, 10), ("b", 30, 10), ("c", 25, 7))
    (tmp_path / "d.mp4").write_bytes(b"x")
    found = "\n".join(problems(open_capture(tmp_path)))
    for words in ("c lacks 3 frames: 7-9", "different frame rates (a, c at 25, b at 30)", "d.mp4: it cannot be read (Invalid data"):
        assert words in found


def test_rates_that_hardly_differ_are_no_problem_where_offsets_are_known(tmp_path):
    """Phones film at 29 or 30 frames per second, whatever they were told: over ten frames that is a third of a frame."""
    write_videos(tmp_path, ("a", 30, 10), ("b", 29, 10))
    assert "so they are not synchronised" in problems(open_capture(tmp_path))[0]
    offsets = tmp_path / "sync.json"
    offsets.write_text('{"format": "fast-gs sync", "version": 1, "offsets": {"a": 0.0, "b": 2.0}}')
    assert problems(open_capture(tmp_path)) == []
    write_videos(tmp_path, ("b", 24, 10))
    (found,) = problems(open_capture(tmp_path))
    assert "drift apart by 2.0 frames, which offsets in sync.json cannot express" in found
    offsets.unlink()
    capture = open_capture(tmp_path)
    for shot in capture.shots:
        object.__setattr__(shot, "t", shot.t * (30 / 24 if shot.view == "b" else 1))  # as timestamps.csv would have it
    assert problems(capture) == []


def test_cameras_json_written_by_us_is_plain_json(capture):
    values = json.loads((capture.path / "cameras.json").read_text())
    assert (values["format"], values["version"], values["frame_count"]) == ("fast-gs capture", 1, FRAMES)
