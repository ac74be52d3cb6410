# SPDX-License-Identifier: GPL-3.0-or-later
"""Joins ES modules to one script, so that a page needs no second file.  No bundler is needed: the modules keep to a few forms.

    import {one, two as other} from "./other.js";       import * as all from "./other.js";
    export function f() {}      and likewise async function, class, const, let, var
    export {one, two};

Each module becomes a function that is called once and gives what the module exports, so names at the top of two modules may be equal.
The last module, the entry, stands as it is, and may wait at its top level.
"""
import posixpath
import re
from collections.abc import Mapping

from ...util.errors import FastGSError

IMPORT = re.compile(r'^import\s+(?:\{([^}]*)\}|\*\s*as\s+(\w+))\s+from\s+"(\.{1,2}/[\w./-]+\.js)";?[ \t]*$', re.MULTILINE)
EXPORT = re.compile(r"^export\s+(?=(?:async\s+)?(?:function\*?|class|const|let|var)\s+(\w+))", re.MULTILINE)
LISTED = re.compile(r"^export\s*\{([\w\s,]*)\};?[ \t]*$", re.MULTILINE)
OTHER = re.compile(r"^(?:import|export)\b.*", re.MULTILINE)
UNSAFE = re.compile(r"</script|<!--", re.IGNORECASE)
"""What would end a script within a page."""


def joined(entry: str, files: Mapping[str, str]) -> str:
    """The script that runs the module `entry`, of the texts of all modules by their paths, such as "main.js".

    Raises FastGSError where a module is missing, has another form of import or export, or would end the script.
    """
    order: list[str] = []
    _visit(entry, files, order, ())
    parts = [_called(name, files[name]) for name in order[:-1]] + [_imports(entry, files[entry])]
    text = "\n".join(parts)
    if UNSAFE.search(text):
        raise FastGSError(f"the script of {entry} holds what ends a script in a page; write it in two parts.")
    return text


def _visit(name: str, files: Mapping[str, str], order: list[str], above: tuple[str, ...]) -> None:
    """Add a module to the order, after all that it imports."""
    if name in above:
        raise FastGSError(f"the modules {' and '.join(above[above.index(name):])} import each other.")
    if name not in files:
        raise FastGSError(f"the module {name}, which {above[-1] if above else 'the page'} needs, is missing; install FAST-GS again.")
    for found in IMPORT.finditer(files[name]):
        _visit(_path(name, found[3]), files, order, (*above, name))
    left = OTHER.search(_plain(IMPORT.sub("", files[name])))
    if left:
        raise FastGSError(f"{name}: this form of import or export cannot be joined: {left[0]}")
    if name not in order:
        order.append(name)


def _plain(text: str) -> str:
    """A module's text without exports."""
    return EXPORT.sub("", LISTED.sub("", text))


def _path(of: str, target: str) -> str:
    """The path of a module that another one imports."""
    return posixpath.normpath(posixpath.join(posixpath.dirname(of), target))


def _variable(name: str) -> str:
    return "$" + re.sub(r"\W", "_", name.removesuffix(".js"))


def _imports(name: str, text: str) -> str:
    """A module's text without exports, with constants in place of its imports."""
    def constant(found: re.Match) -> str:
        source = _variable(_path(name, found[3]))
        names = found[2] or "{" + re.sub(r"\s+as\s+", ": ", found[1]) + "}"
        return f"const {names} = {source};"

    return IMPORT.sub(constant, _plain(text))


def _called(name: str, text: str) -> str:
    """A module as a function that is called once."""
    exported = ", ".join(EXPORT.findall(text) + LISTED.findall(text))
    return f'const {_variable(name)} = (() => {{ "use strict";\n{_imports(name, text)}\nreturn {{{exported}}};\n}})();'
