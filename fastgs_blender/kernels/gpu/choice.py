# SPDX-License-Identifier: GPL-3.0-or-later
"""Chooses the backend for a device's name, by the self-test of each GPU (selftest.py), whose result is stored.

A result is valid for one adapter, its driver and the shaders.  It is stored in gpus.json in the user's folder for caches.  Before a test
starts, "not finished" is stored: where a faulty driver ends the whole program, the next start does not test that GPU again.
"""
import hashlib
import json
import os
from collections.abc import Callable
from contextlib import suppress
from functools import cache

from ...util.errors import FastGSError
from ...util.outputs import replacing
from ...util.reading import read_json
from ...util.verdicts import Verdict, read_verdict
from ..cpu.cache import user_folder
from ..equations import text
from . import shaders
from .adapters import Adapter, adapters, find
from .device import Failure
from .selftest import self_test

VERDICTS = "gpus.json"
UNTESTED = dict.fromkeys(Verdict("").values())
"""The values of an adapter without a verdict."""
UNFINISHED = "the self-test did not come to its end"


def choose(device: str, examine: Callable[[Adapter], Verdict | None] | None = None) -> tuple[str, str]:
    """(the backend's name, a remark or "") of a device: auto, gpu, or a part of an adapter's name; raises FastGSError.

    auto is the first GPU, no software, that has passed the self-test and is faster than the CPU.  Where none is, and where one that was
    named has not passed, it is the CPU.  The remark says why the CPU is used, and what auto has taken.
    examine  gives an adapter's verdict in place of verdict(), None where it has not been tested
    """
    examine, auto = examine or verdict, device == "auto"
    try:
        wanted = [find("" if device in ("auto", "gpu") else device)]
    except FastGSError as error:
        if not auto:
            raise
        return "auto", str(error).removesuffix("; use the device cpu.") + ": the CPU is used."
    if auto:
        wanted += [each for each in adapters() if not each.software]
    refused = []
    for adapter in dict.fromkeys(wanted):
        found = examine(adapter)
        if found is None:
            refused.append(f"{adapter.name} has not been tested yet")
        elif found.fault:
            refused.append(f"{adapter.name} has failed the self-test ({found.fault})")
        elif auto and not found.faster:
            refused.append(f"{adapter.name} is not faster than the CPU ({found.pace})")
        else:
            return f"gpu:{adapter.name}", f"{adapter.name} is used, as it is faster than the CPU ({found.pace})." if auto else ""
    return "auto", f"{'; '.join(refused)}: the CPU is used."


def describe(part: str = "", test: bool = True, again: bool = False, tell: Callable[[str], None] = lambda text: None) -> dict:
    """The adapters whose name holds a text, and what `auto` means, as JSON values.

    test   test those that have not been; else their verdict is None.  again: test the others once more
    tell   is told which adapter is being tested
    """
    try:
        found = [each for each in adapters() if part.lower() in each.name.lower()]
    except Failure:
        found = []
    verdicts: dict[Adapter, Verdict | None] = {}
    for number, each in enumerate(found, 1):
        if test and (again or known(each) is None):
            tell(f"testing {each.name} ({number} of {len(found)})")
        verdicts[each] = verdict(each, again) if test else known(each)
    name, reason = choose("auto", lambda each: verdicts[each] if each in verdicts else known(each))
    listed = [{"name": each.name, "kind": each.kind, "interface": each.interface, "driver": each.driver, "software": each.software,
               "largest_bytes": each.largest, **(found.values() if found else UNTESTED)} for each, found in verdicts.items()]
    return {"devices": listed, "auto": name.partition(":")[2] or None, "reason": reason}


def verdict(adapter: Adapter, again: bool = False) -> Verdict:
    """The verdict of an adapter's self-test.  It is tested where there is no result yet, or once more."""
    if not again and (stored := known(adapter)) is not None:
        return stored
    _keep(adapter, Verdict(UNFINISHED))
    found = self_test(adapter)
    _keep(adapter, found)
    return found


def known(adapter: Adapter) -> Verdict | None:
    """The stored result of an adapter's self-test; None where it has not been tested."""
    return read_verdict(_kept().get(_key(adapter), {}))


def _key(adapter: Adapter) -> str:
    return f"{adapter.name} | {adapter.driver} | {adapter.interface} | {_digest()}"


@cache
def _digest() -> str:
    rooms = shaders.FOLDER.parent, text.FOLDER
    files = [file for room in rooms for kind in ("wgsl", "py") for file in sorted(room.rglob(f"*.{kind}"))]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:12]


def _kept() -> dict[str, dict]:
    """The stored results; none where the file is damaged."""
    path = user_folder() / VERDICTS
    if path.is_file():
        with suppress(FastGSError):
            values = read_json(path)
            if isinstance(values, dict):
                return {key: value for key, value in values.items() if isinstance(value, dict)}
    return {}


def _keep(adapter: Adapter, found: Verdict) -> None:
    """Store a result, if the folder is writable."""
    path = user_folder() / VERDICTS
    with suppress(OSError, FastGSError):
        os.makedirs(path.parent, exist_ok=True)
        with replacing([path]) as (aside,):
            aside.write_text(json.dumps(_kept() | {_key(adapter): found.values()}, indent=1), "utf-8")
