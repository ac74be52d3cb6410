# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs a story inside Blender: blender ... -P inside.py -- MODULE.FUNCTION ARGUMENTS.json ANSWER.json

A story is a function of the arguments that returns facts (what JSON holds) for the test to judge.  In a window it may be a
generator, which yields the seconds to wait: Blender handles events and redraws meanwhile.
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
    bpy.app.timers.register(tick, first_interval=1.0, persistent=True)
    return result


bpy.context.preferences.view.show_splash = False
try:
    story = begin()
except BaseException:  # noqa: BLE001 (the test outside is told of it)
    end(failed=traceback.format_exc())
