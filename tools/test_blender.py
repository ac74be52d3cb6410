# SPDX-License-Identifier: GPL-3.0-or-later
"""Install the extension's zip in the Blenders that Debian releases carry, and run tests/blender on them.

    python tools/test_blender.py [pytest arguments]

BLENDER_SUITES    the releases, default "trixie sid"
REQUIRE_BLENDER   1: fail where no Blender can be set up, instead of saying so on one line
"""
from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import build_extension
import wheels

ROOT = Path(__file__).resolve().parents[1]
OUTPUT = ROOT / "build" / "blender"


def roots(suites: list[str]) -> dict[str, str]:
    """Release -> folder, for those that could be made; the others say why by themselves."""
    script = ROOT / "tools" / "blender_root.sh"
    processes = {suite: subprocess.Popen([script, suite], stdout=subprocess.PIPE, text=True) for suite in suites}
    folders = {suite: process.communicate()[0].strip() for suite, process in processes.items()}
    return {suite: folder for suite, folder in folders.items() if processes[suite].returncode == 0}


def zips() -> dict[str, str]:
    """The zip that users get, and a repository with one for a platform that numba does not know."""
    bundled = wheels.download("linux-x64", ROOT / "build" / "wheels" / "linux-x64")
    full = build_extension.build("linux-x64", bundled, OUTPUT / "zips")
    light = build_extension.build("linux-x64", [w for w in bundled if w.name.startswith("safetensors")], OUTPUT / "zips" / "without-numba")
    build_extension.index([light], light.parent)
    return {"FASTGS_ZIP": str(full), "FASTGS_REPOSITORY_WITHOUT_NUMBA": str(light.parent)}


def main() -> int:
    """The exit status: pytest's, or 0 where there is no Blender and none is required."""
    suites = os.environ.get("BLENDER_SUITES", "trixie sid").split()
    required = os.environ.get("REQUIRE_BLENDER") == "1"
    start = time.monotonic()
    found = roots(suites)
    if len(found) < len(suites) and required:
        return 1
    if not found:
        return 0
    try:
        environment = {**os.environ, **zips()}
    except wheels.Missing as reason:
        print(f"No zip for the Blenders here: {reason}", file=sys.stderr)
        return int(required)
    print(f"{len(found)} Blenders and the zip were ready after {time.monotonic() - start:.0f} s.", flush=True)
    tests = {suite: ring(suite, folder, environment) for suite, folder in found.items()}
    for suite, process in tests.items():
        print(f"Blender of Debian {suite}:\n{process.communicate()[0]}", flush=True)
    print(f"make test-blender took {time.monotonic() - start:.0f} s; logs and pictures are in {OUTPUT.relative_to(ROOT)}.")
    return max(process.returncode for process in tests.values())


def ring(suite: str, folder: str, environment: dict[str, str]) -> subprocess.Popen:
    """The tests on one Blender, under way."""
    own = {"FASTGS_BLENDER_ROOT": folder, "FASTGS_BLENDER_OUTPUT": str(OUTPUT / suite)}
    return subprocess.Popen([sys.executable, "-m", "pytest", "tests/blender", *sys.argv[1:]], cwd=ROOT, env=environment | own,
                            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


if __name__ == "__main__":
    sys.exit(main())
