# SPDX-License-Identifier: GPL-3.0-or-later
"""A real Blender in a Debian root, seen from outside."""
from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from dataclasses import dataclass
from itertools import count
from pathlib import Path

from held_runs import GUARD, HOOK

HERE = Path(__file__).resolve().parent
SHARED = "held_runs", "windows_rules"
"""Modules that stories import, beside those in this folder."""
TOOLS = HERE.parents[1] / "tools"
COMPLAINT = re.compile(r"^(Traceback .*|\w*(Error|Exception)[: ].*|.*(Segmentation fault|SIGSEGV|SIGABRT).*)", re.MULTILINE)
_numbers = count(1)


class Failed(AssertionError):
    """Blender did not do what it was asked to; the text is the end of its log."""


@dataclass
class User:
    """Somebody with a home folder of their own, who starts one of the Blenders.

    root    the Debian root
    folder  the working folder on this machine; Blender sees it as its current folder, and all paths given to it are relative
    home    name of the home folder in it
    """

    root: Path
    folder: Path
    home: str = "home"

    def copy(self, home: str) -> User:
        """Another user, whose home is a copy of this one's."""
        shutil.copytree(self.folder / self.home, self.folder / home, symlinks=True)
        return User(self.root, self.folder, home)

    def run(self, *command, limit=GUARD, expect=0) -> str:
        """Run a command in the root and return what it printed.  Limits are for what hangs, not for machines that are slow."""
        number = next(_numbers)
        log = self.folder / f"log-{number:03}-{Path(command[0]).name}.txt"
        (self.folder / self.home).mkdir(exist_ok=True)
        with log.open("w") as file:
            rules = f"FASTGS_WINDOWS_RULES={os.environ.get('FASTGS_WINDOWS_RULES', '')}"
            line = [TOOLS / "in_root.sh", self.root, self.folder, "env", f"HOME=/mnt/{self.home}", rules, *command]
            try:
                code = subprocess.run(line, stdout=file, stderr=subprocess.STDOUT, timeout=limit, check=False).returncode
            except subprocess.TimeoutExpired:
                raise Failed(f"{log}: not done after {limit} s\n{_tail(log)}") from None
        if expect is not None and code != expect:
            raise Failed(f"{log}: exit status {code}\n{_tail(log)}")
        return log.read_text(errors="replace")

    def blender(self, *arguments, **options) -> str:
        """Blender without a window."""
        return self.run("blender", *arguments, **options)

    def install(self, file: Path) -> str:
        """Install and enable the extension as a user without a window does."""
        shutil.copy(file, self.folder)
        return self.blender("--command", "extension", "install-file", "-r", "user_default", "-e", file.name)

    def install_from(self, repository: Path) -> str:
        """Add an extension repository, a folder with zips and their index, and install the extension from it."""
        folder = self.folder / f"repository-{self.home}"
        shutil.copytree(repository, folder)
        self.blender("--command", "extension", "repo-add", "--url", f"file:///mnt/{folder.name}/index.json", "--name", "Ours", "ours")
        return self.blender("--online-mode", "--command", "extension", "install", "--sync", "-e", "ours.fastgs_blender")

    def story(self, name: str, *arguments, window=False, screen="1280x800", limit=1.5 * GUARD, complaints=(), **facts):
        """Run a story of the modules beside this file (see inside.py).

        arguments   further ones for Blender, such as a .blend file
        screen      the size of the window
        complaints  patterns of log lines that would fail the story and are expected here
        facts       the story's arguments
        Returns the story's facts.  Python errors in Blender's log fail the story, whoever makes them.
        """
        for file in (*HERE.glob("*.py"), HERE / "window.sh", *(HERE.parent / "shared" / f"{name}.py" for name in SHARED)):
            shutil.copy(file, self.folder)
        shutil.copytree(HOOK, self.folder / HOOK.name, dirs_exist_ok=True)
        given, answer = f"{name}-arguments.json", f"{name}-answer.json"
        (self.folder / given).write_text(json.dumps(facts))
        (self.folder / answer).unlink(missing_ok=True)
        command = ["env", f"SCREEN={screen}", "./window.sh"] if window else ["blender", "-b"]
        log = self.run(*command, *arguments, "-P", "inside.py", "--", name, given, answer, limit=limit, expect=None)
        if not (self.folder / answer).exists():
            crashes = [path.read_text(errors="replace") for path in (self.folder / "tmp").glob("*crash.txt")]
            raise Failed("\n".join([f"{name}: Blender ended by itself", log[-4000:], *crashes]))
        outcome = json.loads((self.folder / answer).read_text())
        if "failed" in outcome:
            raise Failed(f"{name}:\n{outcome['failed']}\n{log[-2000:]}")
        wrong = [line for line in complaints_in(log) if not any(re.search(pattern, line) for pattern in complaints)]
        if wrong:
            raise Failed(f"{name}: in Blender's log:\n" + "\n".join(wrong) + "\n" + log[-4000:])
        return outcome["facts"]


def complaints_in(log: str) -> list[str]:
    """The lines of a log that tell of Python errors."""
    return [match.group(0) for match in COMPLAINT.finditer(log)]


def _tail(log: Path) -> str:
    return log.read_text(errors="replace")[-4000:]
