# SPDX-License-Identifier: GPL-3.0-or-later
"""What a moderator of extensions.blender.org looks at, asked of built zips: their terms of service and moderation guidelines.

    python tools/checklist.py dist/store/*.zip

Prints a line for each rule and ends with 1 where one is broken.  The last rules are tried in Blender as a module (tools/tried.py).
"""
from __future__ import annotations

import ast
import hashlib
import json
import re
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from functools import cached_property
from pathlib import Path, PurePosixPath

import build_extension
import sbom
import wheels

LARGEST = 200_000_000
"""Bytes.  The store's makers spoke of 300 MB in May 2024, and no limit is published."""
TEXT = {".py", ".wgsl", ".js", ".css", ".html", ".md", ".txt", ".toml", ".json", ""}
ASSETS = {"examples/fireside.safetensors"}
NETWORK = {"socket", "ssl", "http", "urllib.request", "ftplib", "smtplib", "requests", "urllib3", "webbrowser"}
RESERVED = {"con", "prn", "aux", "nul", *(f"{port}{number}" for port in ("com", "lpt") for number in range(1, 10))}
HERE = {"linux": "linux-x64", "win32": "windows-x64", "darwin": "macos-arm64"}
FOR_A_SYSTEM = re.compile(r"^platforms = .*\n|^wheels = \[\n(?:  .*\n)*\]\n", re.MULTILINE)
"""What a manifest says of the system that its zip is for, as build_extension writes it."""
READS_ITSELF = {
    "fastgs_blender/kernels/cpu/aside.py", "fastgs_blender/jobs/child.py", "fastgs_blender/jobs/command.py",  # programs that they start
    "fastgs_blender/formats/web/page.py", "fastgs_blender/kernels/cpu/cache.py",
    "fastgs_blender/kernels/equations/text.py", "fastgs_blender/kernels/gpu/shaders.py",
    "operators/example.py", "scene/pages.py",
}
EVALUATES = {"scene/drivers.py"}
"""Computes what a driver of the user's file says, where Blender itself would."""


class Zip:
    """A built zip: .names, .manifest, .trees of its modules by name, and .text(name)."""

    def __init__(self, path: Path):
        self.path = path
        self._file = zipfile.ZipFile(path)
        self.names = self._file.namelist()
        self.manifest = tomllib.loads(self.text("blender_manifest.toml"))
        self.wheels = [Path(name) for name in self.names if name.endswith(".whl")]

    def text(self, name: str) -> str:
        return self._file.read(name).decode("utf-8") if name in self.names else ""

    def digest(self, name: str) -> str:
        return hashlib.sha256(self._file.read(name)).hexdigest()

    @cached_property
    def trees(self) -> dict[str, ast.Module]:
        return {name: ast.parse(self.text(name)) for name in self.names if name.endswith(".py")}

    def nodes(self, kind):
        """(module, node) of all nodes of a kind."""
        return [(name, node) for name, tree in self.trees.items() for node in ast.walk(tree) if isinstance(node, kind)]

    def imported(self) -> set[tuple[str, str]]:
        """(module, what it imports absolutely)."""
        found = {(name, alias.name) for name, node in self.nodes(ast.Import) for alias in node.names}
        found |= {(name, f"{node.module}.{alias.name}") for name, node in self.nodes(ast.ImportFrom) if not node.level
                  for alias in node.names}
        return found


def valid(zip_: Zip) -> list[str]:
    """Blender's own tool accepts the zip"""
    try:
        build_extension.blender_ext("validate", str(zip_.path))
    except SystemExit as error:
        return [str(error)]
    return []


def named(zip_: Zip) -> list[str]:
    """The name does not contain Blender's (terms 2.1)"""
    return [zip_.manifest["name"]] if "blender" in zip_.manifest["name"].lower() else []


def small(zip_: Zip) -> list[str]:
    """The zip is smaller than 200 MB"""
    size = zip_.path.stat().st_size
    return [f"{size / 1e6:.0f} MB"] if size >= LARGEST else []


def plain(zip_: Zip) -> list[str]:
    """Only sources, texts, wheels and the example: no bytecode, no pictures, no archives, nothing hidden (terms 3.5, 3.6)"""
    known = ASSETS | {"fastgs_blender/py.typed"} | {str(wheel) for wheel in zip_.wheels}
    return [name for name in zip_.names if name not in known and (PurePosixPath(name).suffix not in TEXT or "/." in f"/{name}")]


def portable(zip_: Zip) -> list[str]:
    """Every system can store the names of the files"""
    folded = [name.casefold() for name in zip_.names]
    parts = {name: PurePosixPath(name).parts for name in zip_.names}
    return [name for name in zip_.names if folded.count(name.casefold()) > 1 or not name.isascii() or len(name) > 120
            or any(re.search(r'[<>:"\\|?*]|[. ]$', part) or part.partition(".")[0].lower() in RESERVED for part in parts[name])]


def readable(zip_: Zip) -> list[str]:
    """The code can be reviewed: Python as people write it, and none that is made while it runs (terms 3.5)"""
    long = [name for name in zip_.trees if max(map(len, zip_.text(name).splitlines()), default=0) > 200]
    made = [f"{name}:{node.lineno} {node.func.id}()" for name, node in zip_.nodes(ast.Call)
            if name not in EVALUATES and isinstance(node.func, ast.Name) and node.func.id in ("eval", "exec", "compile", "__import__")]
    return long + made


def licensed(zip_: Zip) -> list[str]:
    """The code is GPL-3.0-or-later, each module says so, and the example is CC0-1.0 (terms 1)"""
    found = [] if zip_.manifest["license"] == ["SPDX:GPL-3.0-or-later"] else ["manifest"]
    code = [name for name in zip_.names if name.endswith((".py", ".js", ".css"))]
    found += [name for name in code if "SPDX-License-Identifier: GPL-3.0-or-later" not in zip_.text(name)[:200]]
    return found if "CC0 1.0" in zip_.text("examples/LICENSE.txt") else [*found, "examples/LICENSE.txt"]


def credited(zip_: Zip) -> list[str]:
    """Whoever made a part is named in the manifest, its licence in THIRD-PARTY.md or the part, itself in the SBOM (terms 3.8)"""
    listed = {part["bom-ref"]: part for part in json.loads(zip_.text("sbom.cdx.json"))["components"]}
    found = [owner for owner in wheels.holders(zip_.wheels) if owner not in zip_.manifest["copyright"]]
    for name in zip_.names:
        if name.endswith(".whl") or name in sbom.EXAMPLES:
            part = listed.get(PurePosixPath(name).name)
            found += [] if part and part["hashes"][0]["content"] == zip_.digest(name) else [name]
    packages = {wheel.name.split("-")[0].replace("_", "-").lower() for wheel in zip_.wheels}
    told = {line.split(" | ")[0].strip("| ").lower() for line in zip_.text("THIRD-PARTY.md").splitlines() if line.startswith("| ")}
    return [*found, *sorted(packages - told)]


def unmodified(zip_: Zip) -> list[str]:
    """The wheels are the manifest's, for its platform, and as their makers published them (tools/wheels.txt)"""
    locked = wheels.LOCK.read_text("utf-8")
    listed = {name.removeprefix("./") for name in zip_.manifest.get("wheels", ())}
    found = sorted(listed ^ {str(wheel) for wheel in zip_.wheels})
    tags = [tag for platform in zip_.manifest.get("platforms", ()) for tag in ("any", *wheels.TAGS[platform])]
    system = {"linux-x64": "x86_64", "windows-x64": "win_amd64", "macos-arm64": "arm64"}
    ends = ("any", *(system[platform] for platform in zip_.manifest.get("platforms", ()))) if tags else ()
    return found + [str(wheel) for wheel in zip_.wheels if zip_.digest(str(wheel)) not in locked or not wheel.stem.endswith(ends)]


def permitted(zip_: Zip) -> list[str]:
    """The permissions are those that the code needs, each with its reason"""
    text = "\n".join(map(zip_.text, zip_.trees))
    needs = {"files", *(["network"] if downloads(zip_) else ()), *(["clipboard"] if ".clipboard" in text else ())}
    asked = zip_.manifest["permissions"]
    return [*sorted(needs ^ asked.keys()), *(reason for reason in asked.values() if len(reason) > 64 or not reason[-1].isalnum())]


def downloads(zip_: Zip) -> list[str]:
    """Modules that reach for the network, or have pip do it."""
    found = {f"{name} imports {module}" for name, module in zip_.imported() if any(f"{module}.".startswith(f"{net}.") for net in NETWORK)}
    found |= {f"{name} calls pip" for name, node in zip_.nodes(ast.Constant) if node.value == "pip"}
    return sorted(found)


def self_contained(zip_: Zip) -> list[str]:
    """Nothing is downloaded: no pip, no sockets, no self-update (guidelines 4, 5, 11)"""
    return downloads(zip_)


def separate(zip_: Zip) -> list[str]:
    """No module is put where others could find it: imports are relative, sys.path stays as it is"""
    own = {name.split("/")[0] for name in zip_.trees if "/" in name} - {"examples"}
    found = [f"{name} imports {module}" for name, module in sorted(zip_.imported())
             if module.split(".")[0] in own and not name.startswith("examples/")]
    found += [f"{name}:{node.lineno} sys.path" for name, node in zip_.nodes(ast.Call) if isinstance(node.func, ast.Attribute)
              and ast.unparse(node.func) in ("sys.path.append", "sys.path.insert", "sys.path.extend")]
    return found


def beside_itself(zip_: Zip) -> list[str]:
    """__file__ is asked only where the extension reads its own files or starts its own programs"""
    uses = {name for name, node in zip_.nodes(ast.Name) if node.id == "__file__"}
    return sorted(uses - READS_ITSELF)


def behaves(zip_: Zip) -> list[str]:
    """In Blender: registers twice, imports and renders without the network, writes into its own folder alone, leaves nothing"""
    # Blender enables nothing that is for another system: the code of such a zip is tried with the wheels that this Python has
    with tempfile.TemporaryDirectory(prefix="fastgs-checklist-") as folder:
        home = Path(folder) / "user" / "extensions" / "user_default" / zip_.manifest["id"]
        zip_._file.extractall(home)
        if HERE.get(sys.platform) not in zip_.manifest.get("platforms", [HERE.get(sys.platform)]):
            manifest = home / "blender_manifest.toml"
            manifest.write_text(FOR_A_SYSTEM.sub("", manifest.read_text("utf-8")), "utf-8")
        command = [sys.executable, str(Path(__file__).with_name("tried.py")), folder]
        result = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
        found = [line.removeprefix("NO ") for line in result.stdout.splitlines() if line.startswith("NO ")]
        return found or (["it did not come to its end", *result.stderr.splitlines()[-5:]] if result.returncode else [])


RULES = (valid, named, small, plain, portable, readable, licensed, credited, unmodified, permitted, self_contained, separate, beside_itself,
         behaves)


def main(paths: list[str]) -> int:
    """Print the rules and what breaks them; 1 where anything does."""
    broken = 0
    for path in paths:
        zip_ = Zip(Path(path))
        print(f"{zip_.path.name}: {zip_.path.stat().st_size / 1e6:.1f} MB, {len(zip_.names)} files, {len(zip_.wheels)} wheels")
        for rule in RULES:
            found = rule(zip_)
            broken += bool(found)
            print(f"  {'NO ' if found else 'yes'}  {rule.__doc__}{''.join(f'{chr(10)}         {each}' for each in found)}")
    return int(broken > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
