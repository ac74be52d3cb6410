# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs a story inside Blender: blender ... -P inside.py -- MODULE.FUNCTION ARGUMENTS.json ANSWER.json

A story is a function of the arguments that returns facts (what JSON holds) for the test to judge.  In a window it may be a
generator, which yields the seconds to wait: Blender's loop goes round at least once, handles events and redraws.
"""
from __future__ import annotations

import importlib
import json
import os
import sys
import traceback
from inspect import isgenerator

import bpy

name, arguments, answer = sys.argv[sys.argv.index("--") + 1:]
sys.path.append(os.path.dirname(os.path.abspath(__file__)))
importlib.import_module("windows_rules").install()


def end(**outcome):
    """Answer and leave at once: quitting a window asks whether to save."""
    with open(answer, "w", encoding="utf-8") as file:
        json.dump(outcome, file)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)


def tick():
    """One step of the generator."""
    try:
        return next(story)
    except StopIteration as done:
        end(facts=done.value)
    except BaseException:  # noqa: BLE001 (the test outside is told of it)
        end(failed=traceback.format_exc())


def begin():
    """Call the story's function; a generator is left to a timer."""
    module, function = name.split(".")
    with open(arguments, encoding="utf-8") as file:
        result = getattr(importlib.import_module(module), function)(**json.load(file))
    if not isgenerator(result):
        end(facts=result)
    bpy.app.timers.register(tick, first_interval=0.0, persistent=True)
    return at_full_size(result)


def at_full_size(steps):
    """The story, once the window fills the screen and has been drawn."""
    wanted = [int(number) for number in os.environ["SCREEN"].split("x")]
    window = bpy.context.window_manager.windows[0]
    for _ in range(5):
        while [window.width, window.height] != wanted:
            yield 0.05
        yield 0.05
    return (yield from steps)


bpy.context.preferences.view.show_splash = False
bpy.context.preferences.system.viewport_aa = 'FXAA'  # once: eight samples would draw each view eight times, in software
bpy.context.preferences.inputs.mouse_double_click_time = 1  # ms: two clicks of a story are two, however soon the second comes
try:
    story = begin()
except BaseException:  # noqa: BLE001 (the test outside is told of it)
    end(failed=traceback.format_exc())
