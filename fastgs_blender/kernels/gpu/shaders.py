# SPDX-License-Identifier: GPL-3.0-or-later
"""Assembles the text of a shader: wgsl/<stage>.wgsl with the files that it includes, and with its constants filled in.

A line `//include NAME` is replaced by wgsl/NAME.wgsl or the shared ../equations/NAME.wgsl, or, for a device with subgroups, by
wgsl/NAME_subgroups.wgsl where there is one.  `//threads COUNT` is replaced by wgsl/threads.wgsl, the entry point of a stage that says in
thread(n) what each of so many threads does.  {NAME} is replaced by a constant, from the caller's or from CONSTANTS, so that each number
is written in one place only.  Then the lines from `//each c 3` to `//end` are written three times, with 0u, 1u and 2u for c: WebGPU guards
every loop against running for ever, so short loops over arrays cost several times their work.
"""
import re
from functools import cache
from pathlib import Path

from ...rendering.crops import SPHERE, VOLUME
from ...rendering.holdout import EDGE, SAMPLES
from ...rendering.instances import LIMIT
from ...rendering.layout import CORE, DEPTH_FROM, REST
from ...rendering.oracle import T_STOP
from ..equations import text

FOLDER = Path(__file__).parent / "wgsl"
TILE = 16
FARTHEST = 3e38
"""Stands for infinity, which shaders need not know."""

CONSTANTS = text.CONSTANTS | {
    "TILE": TILE, "LIMIT": LIMIT, "T_STOP": T_STOP, "SPHERE": SPHERE, "VOLUME": VOLUME, "SAMPLES": SAMPLES, "EDGE": EDGE,
    "FARTHEST": FARTHEST, "MEDIAN_FROM": DEPTH_FROM["median"], "FIRST_FROM": DEPTH_FROM["first"], "CORE_FROM": CORE[0], "CORE_TO": CORE[1],
    "REST": REST,
}


@cache
def source(stage: str, subgroups: bool = False, **constants: float) -> str:
    """The shader of a stage; text.numbered() shows it with the numbers of its lines."""
    def included(found: re.Match[str]) -> str:
        forward, _, backward = text.read(_file(found[1], subgroups)).partition(text.BACKWARD)
        return forward + backward * stage.endswith("_backward")

    def threads(found: re.Match[str]) -> str:
        return text.read(_file("threads")).replace("COUNT {", f"{found[1]} {{")

    own = re.sub(r"(?m)^//threads (.+)$", threads, text.read(_file(stage)))
    return repeated(text.filled(re.sub(r"(?m)^//include (\w+)$", included, own), CONSTANTS | constants))


def repeated(filled: str) -> str:
    """The text with the lines between //each and //end as often as they ask for, the inner ones first."""
    def lines(found: re.Match[str]) -> str:
        return "".join(re.sub(rf"\b{found[1]}\b", f"{k}u", found[3]) for k in range(int(found[2])))

    count = 1
    while count:
        filled, count = re.subn(r"(?m)^ *//each (\w+) (\d+)\n((?:(?! *//each).*\n)*?) *//end\n", lines, filled)
    return filled


def _file(name: str, subgroups: bool = False) -> Path:
    """The file of a stage, or of what it includes: of this folder, or of the shared equations."""
    files = [FOLDER / f"{name}_subgroups.wgsl"] * subgroups + [FOLDER / f"{name}.wgsl", text.FOLDER / f"{name}.wgsl"]
    return next(file for file in files if file.is_file())
