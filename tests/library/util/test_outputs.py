# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that belong together are replaced together, wherever the process is killed."""
from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import fastgs_blender as fg
from fastgs_blender.util import outputs
from fastgs_blender.util.outputs import complete, replacing

CALLS = ("replace", "unlink")
FILES = ("m.pt", "m.ply")
JOURNAL = re.compile(r"\.fastgs-\w+\.journal")


def write_pair(folder, text: str) -> None:
    with replacing([folder / name for name in FILES]) as parts:
        for part in parts:
            part.write_text(text)


def pair(folder) -> set[str]:
    complete(folder / FILES[-1])
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
"""The step between the two renames: before it the journal is renamed, its temporary file removed, the first file renamed."""
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
        hit = killed_at(step, lambda folder=folder: complete(folder / FILES[-1]))
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
def test_a_model_and_its_decoder_stay_together(tmp_path, rng, make_model):
    kinds = {"basis": "cubic", "rotation_basis": "line", "temporal": "radial", "appearance": "sigmoid"}
    models = [make_model(rng, 5, **kinds), make_model(rng, 7, **kinds)]
    for step in range(20):
        path = tmp_path / f"{step}" / "m.ply"
        path.parent.mkdir()
        fg.save(models[0], path)
        hit = killed_at(step, lambda path=path: fg.save(models[1], path))
        loaded = fg.load(path)
        which = models[0] if len(loaded) == 5 else models[1]
        np.testing.assert_array_equal(loaded.appearance.w1, which.appearance.w1)
        np.testing.assert_array_equal(loaded.features, which.features)
        if not hit:
            assert which is models[1] and step >= 3
            return


@needs_fork
def test_what_was_changed_by_hand_meanwhile_stays(tmp_path):
    write_pair(tmp_path, "old")
    assert killed_at(BETWEEN, lambda: write_pair(tmp_path, "new"))
    (tmp_path / "m.ply").write_text("mine, and longer")
    complete(tmp_path / "m.ply")
    assert (tmp_path / "m.ply").read_text() == "mine, and longer"
    assert sorted(os.listdir(tmp_path)) == sorted(FILES)


@pytest.mark.parametrize("journal", [
    "", "[]", "{", '{"steps": [[null, "../victim", null]], "leftovers": []}', '{"steps": [], "leftovers": ["../victim"]}',
    '{"steps": [["victim", "m.ply", null]], "leftovers": []}', '{"steps": [[".fastgs-000000000000.tmp", "..", null]], "leftovers": []}',
    '{"steps": [1], "leftovers": []}', '{"steps": [[null, "C:\\\\victim", null]], "leftovers": [3]}'])
def test_a_journal_from_a_stranger_touches_nothing_else(tmp_path, journal):
    folder = tmp_path / "folder"
    folder.mkdir()
    for path in (tmp_path / "victim", folder / "victim", folder / ".fastgs-000000000000.tmp"):
        path.write_text("precious")
    outputs._journal(folder / "m.ply").write_text(journal)
    complete(folder / "m.ply")
    assert (tmp_path / "victim").read_text() == (folder / "victim").read_text() == "precious"
    assert sorted(os.listdir(folder)) == [".fastgs-000000000000.tmp", "victim"]


def test_a_rest_that_cannot_be_done_is_a_sentence(tmp_path, monkeypatch):
    (tmp_path / "m.ply").write_text("old")
    part = tmp_path / ".fastgs-000000000000.tmp"
    part.write_text("new")
    step = [part.name, "m.ply", outputs._state(tmp_path / "m.ply")]
    outputs._journal(tmp_path / "m.ply").write_text(json.dumps({"steps": [step], "leftovers": []}))

    def refused(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "replace", refused)
    with pytest.raises(fg.FastGSError, match="stopped halfway.*Permission denied.*writable"):
        complete(tmp_path / "m.ply")
    monkeypatch.undo()
    complete(tmp_path / "m.ply")
    assert os.listdir(tmp_path) == ["m.ply"] and (tmp_path / "m.ply").read_text() == "new"


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
