# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads from the sources which module of the extension imports which: ordinary and lazy imports, modules named in strings, calls of
operators.

A module is the path of its file relative to the root, a package that of its __init__.py.
"""
from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path, PurePosixPath

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("fastgs_blender", "scene", "engine", "operators", "ui")
NAMED = re.compile(r"\.*[a-z_]\w*(?:\.\w+)*\.?")
"""A module's name within a text."""


@cache
def parsed(source: str) -> ast.Module:
    return ast.parse(source)


def extension_files() -> dict[str, str]:
    """The source of every module of the extension."""
    files = ["__init__.py", *(p.relative_to(ROOT).as_posix() for package in PACKAGES for p in sorted((ROOT / package).rglob("*.py")))]
    return {file: (ROOT / file).read_text("utf-8") for file in files}


@cache
def imports(source: str) -> list[tuple[int, str, str]]:
    """(dots, module, name) of every import statement, wherever it stands; name is empty for `import module`."""
    found = []
    for node in ast.walk(parsed(source)):
        if isinstance(node, ast.Import):
            found += [(0, alias.name, "") for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            found += [(node.level, node.module or "", alias.name) for alias in node.names]
    return found


def texts(tree: ast.AST) -> Iterator[str]:
    """All strings but docstrings, and the constant parts of f-strings."""
    documentation = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in documentation:
            yield node.value


def file_of(parts: tuple[str, ...], files) -> str | None:
    """The file of a module by its names from the root; None where there is none."""
    for path in ("/".join(parts) + ".py", "/".join((*parts, "__init__.py"))):
        if path in files:
            return path
    return None


def targets(path: str, source: str, files) -> set[str]:
    """The modules of the extension that `path` imports in any way; of `from package import name` the submodule, if it is one.

    Where the file names modules in strings to import them, every string that is the name of one counts.
    """
    package, found = PurePosixPath(path).parent.parts, set()
    for dots, module, name in imports(source):
        if dots and dots <= len(package) + 1:
            base = (*package[:len(package) - dots + 1], *filter(None, module.split(".")))
            found.add(file_of((*base, name), files) or file_of(base, files))
    if "import_module" in source or "__import__" in source:
        for text in texts(parsed(source)):
            for named in NAMED.findall(text):
                found |= _by_name(named, package, files)
    return found - {None, path}


def _by_name(named: str, package: tuple[str, ...], files) -> set[str | None]:
    """The modules that a text like "..kernels.cpu.backend", "fastgs_blender.cli" or ".layouts." (all of a package) means."""
    bare = named.strip(".")
    dots, parts = len(named) - len(named.lstrip(".")), tuple(bare.split("."))
    bases = [package[:len(package) - dots + 1]] if 0 < dots <= len(package) + 1 else []
    bases += [(), ("fastgs_blender",)] if len(parts) > 1 else []
    if named.endswith(".") and dots:
        folder = "/".join((*bases[0], *parts)) + "/"
        return {file for file in files if file.startswith(folder)}
    return {file_of((*base, *parts), files) for base in bases if base or len(parts) > 1}


def operators(files: dict[str, str]) -> dict[str, str]:
    """The module that defines each of our operators, by its bl_idname."""
    return {name: path for path, source in files.items() for name in _idnames(source)}


@cache
def _idnames(source: str) -> list[str]:
    return re.findall(r'(?m)^    bl_idname = "([a-z_]+\.[a-z_]+)"', source)


def called(path: str, source: str, ours: dict[str, str]) -> set[str]:
    """The modules whose operators `path` calls through bpy.ops, or names in a string."""
    tree = parsed(source)
    names = {f"{node.value.attr}.{node.attr}" for node in ast.walk(tree)
             if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Attribute)
             and isinstance(node.value.value, ast.Attribute) and node.value.value.attr == "ops"}
    return {ours[name] for name in names | set(texts(tree)) if name in ours} - {path}


def circles(graph: dict[str, set[str]]) -> list[set[str]]:
    """The groups of modules that import each other in a circle (Tarjan's strongly connected components of more than one)."""
    number, low, stack, found = {}, {}, [], []

    def visit(module):
        number[module] = low[module] = len(number)
        stack.append(module)
        for other in sorted(graph[module]):
            if other not in number:
                visit(other)
                low[module] = min(low[module], low[other])
            elif other in stack:
                low[module] = min(low[module], number[other])
        if low[module] == number[module]:
            group = set(stack[stack.index(module):])
            del stack[stack.index(module):]
            found.extend([group] if len(group) > 1 else [])

    for module in graph:
        if module not in number:
            visit(module)
    return found
