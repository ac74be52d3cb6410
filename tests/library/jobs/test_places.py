# SPDX-License-Identifier: GPL-3.0-or-later
"""The folder of a run, and what happens to a run that it already holds."""
from __future__ import annotations

import json

import pytest

from fastgs_blender.jobs.places import existing_run, next_free, place_for


@pytest.fixture
def finished(tmp_path):
    """A folder with a finished run."""
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "run.json").write_text(json.dumps({"settings": {"iterations": 2500}}))
    (folder / "status.json").write_text(json.dumps({"state": "finished", "iteration": 2500, "iterations": 2500, "held_out_psnr": 27.791}))
    (folder / "model.safetensors").touch()
    return str(folder)


@pytest.fixture
def begun(tmp_path):
    """A folder with a run that ended before its time."""
    folder = tmp_path / "begun"
    folder.mkdir()
    (folder / "run.json").write_text(json.dumps({"settings": {"iterations": 2500}, "source": {"capture": "/dance"}}))
    (folder / "status.json").write_text(json.dumps({"state": "stopped", "iteration": 250}))
    return str(folder)


def test_what_a_folder_holds(tmp_path, finished, begun):
    assert existing_run(tmp_path / "none") is None and existing_run(tmp_path) is None
    assert existing_run(finished).text == "a finished run (2,500 steps, 27.79 dB)"
    assert existing_run(begun).text .endswith(" 250 of 2,500")
    (tmp_path / "run" / "status.json").write_text("[")
    (tmp_path / "run" / "run.json").write_text('{"settings": 5}')
    assert existing_run(finished).text == "a finished run"


def test_the_next_name_counts_on(tmp_path, finished):
    assert next_free(tmp_path / "new") == str(tmp_path / "new")
    assert next_free(finished) == f"{finished}-2"
    (tmp_path / "run-2").mkdir()
    assert next_free(finished) == next_free(f"{finished}-2") == f"{finished}-3"
    assert next_free(finished, {f"{finished}-3"}) == f"{finished}-4", "another job has that one"


@pytest.mark.parametrize(("choice", "existing", "words"), [
    ('NEW', "", "the new run goes into run-2"), ('OVERWRITE', "--overwrite", "It is deleted"), ('REFUSE', None, "overwrite it"),
    ('RESUME', None, "nothing is left to continue")])
def test_choices_for_a_finished_run(finished, choice, existing, words):
    place = place_for(finished, choice)
    assert words in (place.trouble or place.text) and bool(place.trouble) == (existing is None) and place.asks
    assert existing is None or place.existing == existing
    assert (place.out == finished) == (choice != 'NEW')


def test_an_unfinished_run_continues(begun):
    place = place_for(begun, 'RESUME')
    assert (place.out, place.existing, place.capture) == (begun, "--resume", "/dance") and "continues" in place.text and "250" in place.text


def test_an_empty_folder_is_taken_whatever_the_wish(tmp_path):
    for choice in ('REFUSE', 'RESUME', 'OVERWRITE', 'NEW'):
        place = place_for(str(tmp_path), choice)
        assert (place.out, place.existing, place.trouble, place.asks) == (str(tmp_path), "", "", False)


def test_the_folder_of_a_job_that_has_not_ended(tmp_path, begun):
    assert place_for(begun, 'NEW', {begun: 'TRAINING'}).out == f"{begun}-2"
    assert place_for(begun, 'OVERWRITE', {begun: 'PAUSED'}).trouble and place_for(begun, 'RESUME', {begun: 'TRAINING'}).trouble
    assert place_for(begun, 'RESUME', {begun: 'PAUSED'}).existing == "--resume"
