# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that belong together are replaced together, and what killed processes left is removed."""
from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import fastgs_blender as fg
from fastgs_blender.util import locks, outputs
from fastgs_blender.util.outputs import remove_leftovers, replacing

FILES = ("m.pt", "m.ply")


def write_pair(folder, text: str) -> None:
    with replacing([folder / name for name in FILES]) as parts:
        for part in parts:
            part.write_text(text)


def pair(folder) -> set[str]:
    """The contents of the files."""
    return {(folder / name).read_text() if (folder / name).exists() else "" for name in FILES}


@pytest.mark.parametrize("before", ["old", ""])
@pytest.mark.parametrize("name", FILES)
def test_a_file_that_cannot_be_renamed_leaves_both_as_they_were(tmp_path, monkeypatch, before, name):
    if before:
        write_pair(tmp_path, before)
    really = os.replace

    def refused(source, target):
        if os.path.basename(target) == name and Path(source).read_text() == "new":
            raise PermissionError(13, "another program has it open")
        really(source, target)

    monkeypatch.setattr(os, "replace", refused)
    with pytest.raises(PermissionError):
        write_pair(tmp_path, "new")
    assert pair(tmp_path) == {before} and sorted(os.listdir(tmp_path)) == sorted(FILES if before else [])
    monkeypatch.undo()
    write_pair(tmp_path, "new")
    assert pair(tmp_path) == {"new"} and sorted(os.listdir(tmp_path)) == sorted(FILES)


ASIDE = ".fastgs-000000000000.tmp"
KILLED = """
import os, sys
from pathlib import Path
import numpy as np
from fastgs_blender.util.outputs import replacing
from fastgs_blender.util.tensor_files import write_tensors
with replacing([Path(sys.argv[1])]) as (part,):
    write_tensors(part, {"a": np.zeros(1000, np.float32)}, {})
    (part.parent / ".tmpAbCd").write_bytes(bytes(4000))  # of the library that writes
    print("there", flush=True)
    sys.stdin.read()
"""


def test_what_a_killed_process_left_goes_and_what_a_living_one_writes_stays(tmp_path, monkeypatch):
    killed, living = (subprocess.Popen([sys.executable, "-c", KILLED, str(tmp_path / name)], stdin=subprocess.PIPE,
                                       stdout=subprocess.PIPE) for name in ("a.safetensors", "b.safetensors"))
    with killed, living:
        assert killed.stdout.readline().strip() == living.stdout.readline().strip() == b"there"
        killed.kill()
        killed.wait()
        assert len(os.listdir(tmp_path)) == 2
        monkeypatch.setattr(outputs, "_cleared", set())
        with replacing([tmp_path / "c"]) as (part,):
            part.write_text("c")
        assert len(os.listdir(tmp_path)) == 2, "c, and what is being written"
        living.communicate()
    assert sorted(os.listdir(tmp_path)) == ["b.safetensors", "c"]


def test_a_folder_that_another_process_takes_for_a_dead_ones_is_left_to_it(tmp_path, monkeypatch):
    """It has found the lock before its writer holds it: the writer goes on in another folder, and both its files arrive."""
    own, seen = locks.acquire, []

    def acquire(path):
        path.touch()
        seen.append(path)
        if len(seen) == 1:
            remove_leftovers(tmp_path)  # another process, which holds it for a moment
            assert not path.parent.exists()
        return own(path)

    with monkeypatch.context() as patched:
        patched.setattr(outputs, "_cleared", {str(tmp_path)})
        patched.setattr(locks, "acquire", lambda path: own(path) if any(path.parent == each.parent for each in seen) else acquire(path))
        write_pair(tmp_path, "new")
    assert pair(tmp_path) == {"new"} and sorted(os.listdir(tmp_path)) == sorted(FILES) and len({each.parent for each in seen}) == 2


@pytest.mark.posix
def test_leftovers_of_others_stay(tmp_path, monkeypatch):
    """Files whose writer may live, those of another user, and links."""
    long_ago = outputs.time.time() - 2 * outputs.STALE
    for name, age in ((".fastgs-1.tmp", None), (".fastgs-2.tmp", long_ago), ("a.png", long_ago)):
        (tmp_path / name).touch()
        if age:
            os.utime(tmp_path / name, (age, age))
    (tmp_path / ASIDE).mkdir()
    (tmp_path / ASIDE / outputs.LOCK).touch()
    (tmp_path / ".fastgs-111111111111.tmp").symlink_to(tmp_path / ASIDE)
    with monkeypatch.context() as patched:
        patched.setattr(outputs, "_ours", lambda path: False)
        remove_leftovers(tmp_path)
    assert (tmp_path / ASIDE).exists()
    remove_leftovers(tmp_path)
    assert set(os.listdir(tmp_path)) == {".fastgs-1.tmp", ".fastgs-111111111111.tmp", "a.png"}


@pytest.mark.posix
def test_a_lock_is_an_ordinary_file(tmp_path):
    """An archive may bring a hidden folder whose lock is a link: it would make a file wherever it leads."""
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(fg.FastGSError, match="pipe"):
        locks.acquire(tmp_path / "pipe")
    (tmp_path / ASIDE).mkdir()
    (tmp_path / ASIDE / outputs.LOCK).symlink_to(tmp_path / "victim")
    os.utime(tmp_path / ASIDE, (0, 0))
    with pytest.raises(OSError, match="link"):
        locks.acquire(tmp_path / ASIDE / outputs.LOCK)
    remove_leftovers(tmp_path)
    assert not (tmp_path / "victim").exists()


@pytest.mark.posix
def test_a_pipe_is_not_appended_to(tmp_path):
    os.mkfifo(tmp_path / "log")
    with pytest.raises(fg.FastGSError, match="pipe"):
        outputs.appending(tmp_path / "log")
    reader = os.open(tmp_path / "log", os.O_RDONLY | os.O_NONBLOCK)
    with pytest.raises(fg.FastGSError, match="pipe"):
        outputs.appending(tmp_path / "log")
    os.close(reader)
    for _ in range(2):
        with outputs.appending(tmp_path / "text", "a", encoding="utf-8") as file:
            file.write("é")
    assert (tmp_path / "text").read_text("utf-8") == "éé"


@pytest.mark.posix
def test_links_into_different_folders_are_refused(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "m.pt").symlink_to(tmp_path / "elsewhere" / "m.pt")
    with pytest.raises(fg.FastGSError, match="different folders"):
        write_pair(tmp_path, "new")


@pytest.mark.posix
def test_the_longest_names_are_replaced_together_too(tmp_path):
    paths = [tmp_path / ("n" * 240 + end) for end in (".pt", ".ply")]
    for text in ("old", "new"):
        with replacing(paths) as parts:
            for part in parts:
                part.write_text(text)
    assert [path.read_text() for path in paths] == ["new", "new"]
