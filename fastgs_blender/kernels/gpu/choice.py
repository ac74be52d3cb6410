# SPDX-License-Identifier: GPL-3.0-or-later
"""Chooses the backend for a device's name, by the self-test of each GPU (selftest.py), whose result is stored.

A result is valid for one adapter, its driver and the shaders.  It is stored in gpus.json in the user's folder for caches.  Before a test
starts, "not finished" is stored: where a faulty driver ends the whole program, the next start does not test that GPU again.
"""
from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from contextlib import suppress
from functools import cache

from ...util.errors import FastGSError
from ...util.outputs import replacing
from ...util.reading import read_json
from ..cpu.cache import user_folder
from . import shaders
from .adapters import Adapter, adapters, find
from .device import Failure
from .selftest import test

VERDICTS = "gpus.json"
UNFINISHED = "the self-test did not come to its end"


def choose(device: str, examine: Callable[[Adapter], str | None] | None = None) -> tuple[str, str]:
    """(the backend's name, a remark or "") of a device: auto, gpu, or a part of an adapter's name; raises FastGSError.

    auto is the first GPU, no software, that has passed the self-test.  Where none has, and where one that was named has not, it is the
    CPU, and the remark says why.
    examine  gives an adapter's verdict in place of verdict(), None where it has not been tested
    """
    examine = examine or verdict
    try:
        wanted = [find("" if device in ("auto", "gpu") else device)]
    except FastGSError as error:
        if device != "auto":
            raise
        return "auto", str(error).removesuffix("; use the device cpu.") + ": the CPU is used."
    if device == "auto":
        wanted += [each for each in adapters() if not each.software]
    failed = []
    for adapter in dict.fromkeys(wanted):
        wrong = examine(adapter)
        if wrong == "":
            return f"gpu:{adapter.name}", ""
        failed.append(f"{adapter.name} " + ("has not been tested yet" if wrong is None else f"has failed the self-test ({wrong})"))
    return "auto", f"{'; '.join(failed)}: the CPU is used."


def describe(part: str = "", test: bool = True, again: bool = False, tell: Callable[[str], None] = lambda text: None) -> dict:
    """The adapters whose name holds a text, and what `auto` means, as JSON values.

    test   test those that have not been; else their verdict is None.  again: test the others once more
    tell   is told which adapter is being tested
    """
    try:
        found = [each for each in adapters() if part.lower() in each.name.lower()]
    except Failure:
        found = []
    verdicts = {}
    for number, each in enumerate(found, 1):
        if test and (again or known(each) is None):
            tell(f"testing {each.name} ({number} of {len(found)})")
        verdicts[each] = verdict(each, again) if test else known(each)
    name, reason = choose("auto", lambda each: verdicts[each] if each in verdicts else known(each))
    listed = [{"name": each.name, "kind": each.kind, "interface": each.interface, "driver": each.driver, "software": each.software,
               "largest_bytes": each.largest, "self_test": wrong} for each, wrong in verdicts.items()]
    return {"devices": listed, "auto": name.partition(":")[2] or None, "reason": reason}


def verdict(adapter: Adapter, again: bool = False) -> str:
    """The fault of an adapter as a clause, "" where it has passed the self-test.  It is tested where there is no result yet, or once
    more."""
    if not again and (found := known(adapter)) is not None:
        return found
    _keep(adapter, UNFINISHED)
    found = test(adapter)
    _keep(adapter, found)
    return found


def known(adapter: Adapter) -> str | None:
    """The stored result of an adapter's self-test; None where it has not been tested."""
    return _kept().get(_key(adapter))


def _key(adapter: Adapter) -> str:
    return f"{adapter.name} | {adapter.driver} | {adapter.interface} | {_digest()}"


@cache
def _digest() -> str:
    files = sorted(shaders.FOLDER.parent.rglob("*.wgsl")) + sorted(shaders.FOLDER.parent.glob("*.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:12]


def _kept() -> dict[str, str]:
    """The stored results; none where the file is damaged."""
    path = user_folder() / VERDICTS
    if path.is_file():
        with suppress(FastGSError):
            values = read_json(path)
            if isinstance(values, dict):
                return {key: value for key, value in values.items() if isinstance(value, str)}
    return {}


def _keep(adapter: Adapter, wrong: str) -> None:
    """Store a result, if the folder is writable."""
    path = user_folder() / VERDICTS
    with suppress(OSError, FastGSError):
        os.makedirs(path.parent, exist_ok=True)
        with replacing([path]) as (aside,):
            aside.write_text(json.dumps(_kept() | {_key(adapter): wrong}, indent=1), "utf-8")
