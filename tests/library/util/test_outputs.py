# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that belong together are replaced together, wherever the process is killed."""
from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import fastgs_blender as fg
from fastgs_blender.util import locks, outputs
from fastgs_blender.util.outputs import check_whole, complete, remove_leftovers, replacing

CALLS = ("mkdir", "replace", "unlink", "rmdir")
FILES = ("m.pt", "m.ply")
JOURNAL = re.compile(r"\.fastgs-\w+\.journal")


def write_pair(folder, text: str) -> None:
    with replacing([folder / name for name in FILES]) as parts:
        for part in parts:
            part.write_text(text)


def pair(folder) -> set[str]:
    """What the files hold when the next writer has completed what was begun."""
    complete(folder / name for name in FILES)
    return {(folder / name).read_text() if (folder / name).exists() else "" for name in FILES}


def killed_at(step: int, work) -> bool:
    """Whether work() comes to its step-th change of the folder; it is done in a child process that ends just before it, as if killed."""
    child = os.fork()
    if child == 0:
        left = [step]

        def dying(call):
            def do(*args, **kwargs):
                left[0] -= 1
                if left[0] < 0:
                    os._exit(9)
                return call(*args, **kwargs)
            return do

        for name in CALLS:
            setattr(os, name, dying(getattr(os, name)))
        try:
            work()
        finally:
            os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9


BETWEEN = 3
"""The step between the two renames: before it the hidden folder is made, the journal renamed, the first file renamed."""
needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="the process that is killed is forked")


@needs_fork
@pytest.mark.parametrize("before", ["old", ""])
def test_a_kill_at_any_step_leaves_both_old_or_both_new(tmp_path, before):
    step, seen = 0, set()
    while True:
        folder = tmp_path / str(step)
        folder.mkdir()
        if before:
            write_pair(folder, before)
        if not killed_at(step, lambda folder=folder: write_pair(folder, "new")):
            break
        found = pair(folder)
        assert found in ({before}, {"new"}), step
        seen |= found
        write_pair(folder, "newer")
        assert pair(folder) == {"newer"} and not JOURNAL.search(str(os.listdir(folder)))
        step += 1
    assert step >= 3 and seen == {before, "new"} and pair(folder) == {"new"}
    assert sorted(os.listdir(folder)) == sorted(FILES)


@needs_fork
def test_a_kill_while_the_rest_is_done_is_survived_too(tmp_path):
    for step in range(20):
        folder = tmp_path / str(step)
        folder.mkdir()
        write_pair(folder, "old")
        if not killed_at(BETWEEN, lambda folder=folder: write_pair(folder, "new")):
            raise AssertionError("there are fewer steps than this test thinks")
        assert {(folder / name).read_text() for name in FILES} == {"old", "new"}, "this is the moment that is tested"
        hit = killed_at(step, lambda folder=folder: complete(folder / name for name in FILES))
        assert pair(folder) == {"new"}
        if not hit:
            assert step > 2
            return


@needs_fork
def test_a_kill_while_a_failure_is_undone_is_survived_too(tmp_path):
    step = 0
    while True:
        folder = tmp_path / str(step)
        folder.mkdir()
        write_pair(folder, "old")

        def fail(folder=folder):
            really = os.replace

            def refused(source, target):
                if os.path.basename(target) == FILES[-1] and Path(source).read_text() == "new":
                    raise PermissionError(13, "another program has it open")
                really(source, target)

            os.replace = refused
            write_pair(folder, "new")

        hit = killed_at(step, fail)
        assert pair(folder) in ({"old"}, {"new"}), step
        step += 1
        if not hit:
            break
    assert step > 3 and pair(folder) == {"old"} and sorted(os.listdir(folder)) == sorted(FILES)


@needs_fork
@pytest.mark.filterwarnings("ignore::fastgs_blender.LossWarning")
def test_a_model_and_its_decoder_stay_together(tmp_path, rng, make_model, monkeypatch):
    kinds = {"basis": "cubic", "rotation_basis": "line", "temporal": "radial", "appearance": "sigmoid"}
    models = [make_model(rng, 5, **kinds), make_model(rng, 7, **kinds)]
    told = []
    monkeypatch.setattr(outputs, "PATIENCE", 0)
    for step in range(20):
        path = tmp_path / f"{step}" / "m.ply"
        path.parent.mkdir()
        fg.save(models[0], path)
        hit = killed_at(step, lambda path=path: fg.save(models[1], path))
        try:
            loaded = fg.load(path)
        except fg.FastGSError as error:
            told.append(str(error))
            continue
        which = models[0] if len(loaded) == 5 else models[1]
        np.testing.assert_array_equal(loaded.appearance.w1, which.appearance.w1)
        np.testing.assert_array_equal(loaded.features, which.features)
        if not hit:
            assert which is models[1] and len(told) == 1 and "stopped halfway" in told[0] and "save it" in told[0]
            return


@needs_fork
def test_what_was_changed_by_hand_meanwhile_stays(tmp_path):
    write_pair(tmp_path, "old")
    assert killed_at(BETWEEN, lambda: write_pair(tmp_path, "new"))
    (tmp_path / "m.ply").write_text("mine, and longer")
    complete(tmp_path / name for name in FILES)
    assert (tmp_path / "m.ply").read_text() == "mine, and longer"
    assert sorted(os.listdir(tmp_path)) == sorted(FILES)


ASIDE = ".fastgs-000000000000.tmp"


def journal(folder, *steps, aside=ASIDE, undo=False) -> Path:
    """A journal of m.ply, beside a hidden folder with a new m.ply in it."""
    (folder / ASIDE).mkdir(parents=True, exist_ok=True)
    (folder / ASIDE / "m.ply").write_text("new")
    path = outputs._journal(folder / "m.ply")
    path.write_text(json.dumps({"steps": steps, "aside": aside, "undo": undo}))
    return path


def listing(folder) -> dict[str, str]:
    return {str(path.relative_to(folder)): path.read_text() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("steps", [
    ["m.ply", "../victim"], ["../victim", "m.ply"], [None, "../victim"], [None, "victim"], ["m.ply", "victim"], ["m.ply", ".."],
    ["victim", ""], [None, "C:\\victim"], [None, 3], [3, "m.ply"], [["m.ply"], "m.ply"]])
@pytest.mark.parametrize("aside", [ASIDE, "..", ".", "victim", 3, None])
def test_a_journal_from_a_stranger_touches_nothing_else(tmp_path, steps, aside):
    folder = tmp_path / "folder"
    folder.mkdir()
    for path in (tmp_path / "victim", folder / "victim", folder / "m.ply"):
        path.write_text("precious")
    state = outputs._state(folder / "victim")
    made = journal(folder, [*steps, state], [None, "m.ply", outputs._state(folder / "m.ply")], aside=aside)
    before = listing(tmp_path)
    check_whole(folder / "m.ply")
    assert listing(tmp_path) == before, "reading changes nothing"
    complete([folder / "m.ply"])
    made_name = str(made.relative_to(tmp_path))
    assert listing(tmp_path) == {name: text for name, text in before.items() if name != made_name}


@pytest.mark.parametrize("source", ["C:m.ply", "m.ply:a", "other", ".before-", ".before-0x", ".held"])
def test_a_journal_takes_nothing_but_what_was_written(tmp_path, source):
    """C:m.ply lies in the hidden folder here; on Windows it lies in whatever folder is open on that disk."""
    (tmp_path / "m.ply").write_text("old")
    journal(tmp_path, [source, "m.ply", outputs._state(tmp_path / "m.ply")])
    (tmp_path / ASIDE / source).write_text("precious")
    complete([tmp_path / "m.ply"])
    assert (tmp_path / "m.ply").read_text() == "old" and not outputs._journal(tmp_path / "m.ply").exists()


def test_a_journal_of_names_that_no_file_can_have_is_no_error(tmp_path):
    made = journal(tmp_path, ["m" * 300, "m" * 300, None])
    check_whole(tmp_path / "m.ply")
    complete([tmp_path / "m.ply"])
    assert not made.exists()


@pytest.mark.parametrize("content", ["", "[]", "{", '{"steps": [1], "aside": 1, "undo": 2}', "[" * 5000])
def test_a_damaged_journal_is_removed_by_who_writes(tmp_path, content):
    made = outputs._journal(tmp_path / "m.ply")
    made.write_text(content)
    check_whole(tmp_path / "m.ply")
    assert made.exists()
    with replacing([tmp_path / "m.ply"]) as (part,):
        part.write_text("new")
    assert listing(tmp_path) == {"m.ply": "new"}


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="files have no owners there")
@pytest.mark.parametrize("what", ["journal", "aside"])
def test_a_journal_of_another_user_is_not_followed(tmp_path, monkeypatch, what):
    (tmp_path / "m.ply").write_text("old")
    made = journal(tmp_path, ["m.ply", "m.ply", outputs._state(tmp_path / "m.ply")])
    strange = {"journal": made, "aside": tmp_path / ASIDE}[what]
    really = outputs._ours
    monkeypatch.setattr(outputs, "_ours", lambda path: really(path) and path != strange)
    complete([tmp_path / "m.ply"])
    assert (tmp_path / "m.ply").read_text() == "old"


def test_reading_waits_for_who_is_renaming(tmp_path, monkeypatch):
    for name in FILES:
        (tmp_path / name).write_text("old")
    made = journal(tmp_path, ["m.pt", "m.pt", [0, 0]], ["m.ply", "m.ply", outputs._state(tmp_path / "m.ply")])
    looks = []
    monkeypatch.setattr(outputs.time, "sleep", lambda seconds: looks.append(seconds) or (len(looks) == 3 and made.unlink()))
    check_whole(tmp_path / "m.ply")
    assert len(looks) == 3 and (tmp_path / "m.ply").read_text() == "old"


def test_a_rest_that_cannot_be_done_is_a_sentence(tmp_path, monkeypatch):
    (tmp_path / "m.ply").write_text("old")
    journal(tmp_path, ["m.ply", "m.ply", outputs._state(tmp_path / "m.ply")])

    def refused(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "replace", refused)
    with pytest.raises(fg.FastGSError, match="stopped halfway.*Permission denied.*writable"):
        complete([tmp_path / "m.ply"])
    monkeypatch.undo()
    complete([tmp_path / "m.ply"])
    assert listing(tmp_path) == {"m.ply": "new"} and os.listdir(tmp_path) == ["m.ply"]


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
        assert killed.stdout.readline() == living.stdout.readline() == b"there\n"
        killed.kill()
        killed.wait()
        assert len(os.listdir(tmp_path)) == 2
        monkeypatch.setattr(outputs, "_cleared", set())
        with replacing([tmp_path / "c"]) as (part,):
            part.write_text("c")
        assert len(os.listdir(tmp_path)) == 2, "c, and what is being written"
        living.communicate()
    assert sorted(os.listdir(tmp_path)) == ["b.safetensors", "c"]


def test_leftovers_of_others_stay(tmp_path, monkeypatch):
    """Files whose writer may live, those that a journal needs, those of another user, and links."""
    long_ago = outputs.time.time() - 2 * outputs.STALE
    for name, age in ((".fastgs-1.tmp", None), (".fastgs-2.tmp", long_ago), ("a.png", long_ago)):
        (tmp_path / name).touch()
        if age:
            os.utime(tmp_path / name, (age, age))
    (tmp_path / "m.ply").write_text("old")
    journal(tmp_path, ["m.ply", "m.ply", outputs._state(tmp_path / "m.ply")])
    (tmp_path / ASIDE / outputs.LOCK).touch()
    (tmp_path / ".fastgs-111111111111.tmp").symlink_to(tmp_path / ASIDE)
    remove_leftovers(tmp_path)
    kept = {ASIDE, ".fastgs-1.tmp", ".fastgs-111111111111.tmp", "a.png", "m.ply"}
    assert {name for name in os.listdir(tmp_path) if not JOURNAL.fullmatch(name)} == kept
    outputs._journal(tmp_path / "m.ply").unlink()
    monkeypatch.setattr(outputs, "_ours", lambda path: False)
    remove_leftovers(tmp_path)
    assert (tmp_path / ASIDE).exists()
    monkeypatch.undo()
    remove_leftovers(tmp_path)
    assert not (tmp_path / ASIDE).exists()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes")
def test_a_lock_is_an_ordinary_file(tmp_path):
    """An archive may bring a hidden folder whose lock is a link: it would make a file wherever it leads."""
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(fg.FastGSError, match="pipe"):
        locks.hold(tmp_path / "pipe")
    (tmp_path / ASIDE).mkdir()
    (tmp_path / ASIDE / outputs.LOCK).symlink_to(tmp_path / "victim")
    os.utime(tmp_path / ASIDE, (0, 0))
    with pytest.raises(OSError, match="link"):
        locks.hold(tmp_path / ASIDE / outputs.LOCK)
    remove_leftovers(tmp_path)
    assert not (tmp_path / "victim").exists()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes")
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


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights there")
def test_links_into_different_folders_are_refused(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "m.pt").symlink_to(tmp_path / "elsewhere" / "m.pt")
    with pytest.raises(fg.FastGSError, match="different folders"):
        write_pair(tmp_path, "new")


def test_the_longest_names_are_replaced_together_too(tmp_path):
    paths = [tmp_path / ("n" * 240 + end) for end in (".pt", ".ply")]
    for text in ("old", "new"):
        with replacing(paths) as parts:
            for part in parts:
                part.write_text(text)
    assert [path.read_text() for path in paths] == ["new", "new"]
