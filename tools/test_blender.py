# SPDX-License-Identifier: GPL-3.0-or-later
"""Install the extension's zip in the Blenders that Debian releases carry, and run tests/blender on them.

    python tools/test_blender.py [pytest arguments]

BLENDER_SUITES          the suites, default "trixie sid pages": two releases, and web pages in the browsers of trixie's root
WINDOWS_RULES           those of them in which our code may do what Windows allows, and no more (tests/shared/windows_rules.py), default ""
ALLOW_MISSING_BLENDER   1: test those Blenders that can be set up, and pass where there is none; without it one that is left out is
                        a failure
"""
from __future__ import annotations

import fcntl
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import build_extension
import wheels

ROOT = Path(__file__).resolve().parents[1]
OUTPUT = ROOT / "build" / "blender"
FAILED = OUTPUT / "failed"
"""The suites in which tests failed, in a line; absent while tests run, and where they did not come to their end."""
BROWSERS = "trixie"
"""The release whose root has browsers."""
PAGES = ("test_damaged_pages.py", "test_page_pictures.py", "test_web_hands.py", "test_web_stage.py")
"""Files of tests that open web pages and start no Blender.  They run beside the others, whose windows wait for much of their time."""
NOTHING = 5
"""pytest's exit status where none of a suite's tests was asked for."""
PATIENCE = 1200
"""Seconds to wait for a Debian mirror, whatever is slow about it."""


def release(suite: str) -> str:
    """The release whose root a suite runs in."""
    return BROWSERS if suite == "pages" else suite


def roots(suites: list[str]) -> dict[str, str]:
    """Release -> folder, for those that could be made; of the others one line says why."""
    script = ROOT / "tools" / "blender_root.sh"
    subprocess.run([script, "--tools"], check=False)  # first and once; what is wrong with them, each release says again below
    processes = {suite: subprocess.Popen([script, suite], stdout=subprocess.PIPE, text=True, start_new_session=True) for suite in suites}
    end, folders = time.monotonic() + PATIENCE, {}
    for suite, process in processes.items():
        try:
            folder = process.communicate(timeout=max(end - time.monotonic(), 1))[0].strip()
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGTERM)
            process.wait()
            print(f"No Blender of Debian {suite} here: its root was not ready after {PATIENCE // 60} minutes.", file=sys.stderr)
            continue
        if process.returncode == 0:
            folders[suite] = folder
        elif process.returncode not in (3, 4):  # at these the script has said it
            print(f"No Blender of Debian {suite} here: blender_root.sh ended with {process.returncode}.", file=sys.stderr)
    return folders


def zips(python: str) -> dict[str, str]:
    """The zip that users get for a Python, and a repository with one for a platform that numba does not know."""
    name = next(name for name, pythons in wheels.ZIPS.items() if wheels.platform_of(name) == "linux-x64" and python in pythons)
    bundled = wheels.download(name, ROOT / "build" / "wheels" / name)
    full = build_extension.build(name, bundled, OUTPUT / "zips")
    without = OUTPUT / "zips" / f"without-numba-{python}"
    light = build_extension.build(name, [w for w in bundled if w.name.startswith("safetensors")], without)
    build_extension.index([light], without)
    return {"FASTGS_ZIP": str(full), "FASTGS_REPOSITORY_WITHOUT_NUMBA": str(without)}


def python_of(folder: str) -> str:
    """The Python, as 3.13, of the Blender in a root: Debian builds it for its own."""
    return next(path.name.removeprefix("python") for path in Path(folder, "usr", "lib").glob("python3.*"))


def main() -> int:
    """The exit status: 1 where a test fails, or where a Blender is left out and ALLOW_MISSING_BLENDER is not set."""
    if {"-h", "--help"} & set(sys.argv[1:]):
        print(__doc__)
        return 0
    suites = os.environ.get("BLENDER_SUITES", "trixie sid pages").split()
    lenient = os.environ.get("ALLOW_MISSING_BLENDER") == "1"
    start = time.monotonic()
    FAILED.unlink(missing_ok=True)
    made_roots = roots(list(dict.fromkeys(map(release, suites))))
    found = {suite: made_roots[release(suite)] for suite in suites if release(suite) in made_roots}
    left_out = [suite for suite in suites if suite not in found]
    if left_out and not lenient:
        print(f"make test-blender fails: no Blender of Debian {', '.join(left_out)} was tested.  ALLOW_MISSING_BLENDER=1 leaves it out.",
              file=sys.stderr)
        return 1
    if not found:
        return 0
    OUTPUT.mkdir(parents=True, exist_ok=True)
    turn = (OUTPUT / ".lock").open("w")
    fcntl.flock(turn, fcntl.LOCK_EX)  # another run would write into the same folders; the lock goes with this process
    try:
        made = {python: zips(python) for python in {python_of(folder) for folder in found.values()}}
    except wheels.Missing as reason:
        print(f"No zip for the Blenders here: {reason}", file=sys.stderr)
        return int(not lenient)
    print(f"{len(made_roots)} Blenders and their zips were ready after {time.monotonic() - start:.0f} s.", flush=True)
    signal.signal(signal.SIGTERM, ask_to_end)  # who waits no longer still sees how far the tests came
    tests = {suite: ring(suite, folder, {**os.environ, **made[python_of(folder)]}, suite == "sid" or "sid" not in found)
             for suite, folder in found.items()}
    try:
        for process in tests.values():
            process.wait()
    finally:
        for process in tests.values():
            process.send_signal(signal.SIGINT)  # pytest says where it is, and ends
        for suite, process in tests.items():
            ended(process)
            print(f"Debian {suite}:\n{report(suite).read_text(errors='replace')}", flush=True)
    print(f"make test-blender took {time.monotonic() - start:.0f} s; logs and pictures are in {OUTPUT.relative_to(ROOT)}.")
    failed = [suite for suite, process in tests.items() if process.returncode not in (0, NOTHING)]
    if failed:
        FAILED.write_text(" ".join(failed) + "\n")
    return int(bool(failed) or all(process.returncode for process in tests.values()))


def ask_to_end(*_: object) -> None:
    """End this process, once: timeout and make both say so."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    sys.exit(1)


def report(suite: str) -> Path:
    """What the tests of a suite print."""
    return OUTPUT / f"tests-{suite}.txt"


def ended(process: subprocess.Popen) -> None:
    """Wait for tests that were asked to end; those that do not are killed."""
    try:
        process.wait(20)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def ring(suite: str, folder: str, environment: dict[str, str], newest: bool) -> subprocess.Popen:
    """The tests of one suite, under way.  What failed is remembered for each apart, for --last-failed.

    Without `newest`, tests of that mark are left to the other release.
    """
    known = OUTPUT / f"tests-{suite}"
    if not {"--lf", "--last-failed"} & set(sys.argv[1:]):
        shutil.rmtree(known, ignore_errors=True)
    rules = str(int(suite in os.environ.get("WINDOWS_RULES", "").split()))
    own = {"FASTGS_BLENDER_ROOT": folder, "FASTGS_BLENDER_OUTPUT": str(OUTPUT / suite), "FASTGS_WINDOWS_RULES": rules}
    files = [f"tests/blender/{name}" for name in PAGES] if suite == "pages" else [
        "tests/blender", *(f"--ignore=tests/blender/{name}" for name in PAGES)]
    command = [sys.executable, "-m", "pytest", *files, "-v", "--durations=15", "-o", f"cache_dir={known}",
               *([] if newest or suite == "pages" else ["-m", "not newest"]), *sys.argv[1:]]
    with report(suite).open("w") as file:  # a session of its own: a signal to all of this group is not for the tests
        return subprocess.Popen(command, cwd=ROOT, env=environment | own, stdout=file, stderr=subprocess.STDOUT, start_new_session=True)


if __name__ == "__main__":
    sys.exit(main())
