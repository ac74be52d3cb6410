# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes docs/api.md from the docstrings of the library's public face (fastgs_blender/__init__.py); a test holds it up to date."""
from __future__ import annotations

import ast
import inspect
import sys
import textwrap
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "api.md"
GROUPS = {
    "Files": ("load", "save", "open_source"),
    "Pictures": ("render", "save_image", "psnr", "Instance", "ObjectSettings", "Crop", "Exposure", "Aperture", "PassSettings"),
    "Cameras": ("Camera", "View", "look_at", "load_cameras", "save_cameras", "orbit", "dolly", "through"),
    "Captures and training": ("open_capture", "Capture", "check", "CheckReport", "find_offsets", "Clocks", "write_clocks",
                              "train", "evaluate"),
    "Baking, and meshes of models": ("bake", "BakeReport", "make_mesh", "MovingMesh"),
    "Two captures, and loops": ("align", "Alignment", "similarity", "Similarity", "match_grade", "Grade", "find_loop", "Loop"),
    "Models": ("GaussianModel", "Clip", "Raster", "Surroundings", "Backdrop", "Viewpoint", "Sequence", "Chapters", "chapters",
               "slice_model", "Slice", "freeze", "concatenate", "Edit", "Parts", "clean", "Cleaning"),
    "How Gaussians move": ("Static", "Fourier", "Cosine", "Polynomial", "Keyframes"),
    "How they come and go": ("Always", "Radial", "Window", "WindowedRadial"),
    "How they look": ("RGB", "SH", "Features", "Changing"),
    "Errors": ("FastGSError", "LossWarning"),
}
HEAD = """# The Python library

*tools/api_docs.py writes this page from the docstrings; `help(fg)` and `help(fg.render)` show the same.*

```python
{overview}
```

{rest}
"""
WIDTH = 110


def page() -> str:
    """The text of docs/api.md."""
    import fastgs_blender as fg

    _, _, rest = inspect.getdoc(fg).partition("\n\n")
    code, _, last = rest.rpartition("\n\n")
    parts = [HEAD.format(overview="\n".join(line[4:] for line in code.splitlines()), rest=last)]
    for title, names in GROUPS.items():
        parts.append(f"## {title}\n")
        parts += [entry(name, getattr(fg, name)) for name in names]
    return "\n".join(parts)


def entry(name: str, what: object) -> str:
    """The description of one member, its example set apart."""
    text, _, example = inspect.getdoc(what).partition("\n\nExample:\n")
    lines = [f"### {name}\n", f"```python\n{signature(name, what)}\n```\n", f"```text\n{text}\n```\n"]
    if inspect.isclass(what) and (known := members(what)):
        lines += [*known, ""]
    if example:
        lines.append(f"```python\n{textwrap.dedent(example).strip()}\n```\n")
    return "\n".join(lines)


def signature(name: str, what: object) -> str:
    """fg.name(...), wrapped between its arguments."""
    if inspect.isclass(what) and issubclass(what, Exception):
        return f"fg.{name}"
    found = inspect.signature(what)
    head, lines = f"fg.{name}(", [""]
    arguments = []
    for parameter in found.parameters.values():
        if parameter.kind is parameter.KEYWORD_ONLY and "*" not in arguments:
            arguments.append("*")
        default = "" if parameter.default is parameter.empty else f"={shown(parameter.default)}"
        arguments.append(("**" if parameter.kind is parameter.VAR_KEYWORD else "") + parameter.name + default)
    for i, text in enumerate(arguments):
        text += "" if i == len(arguments) - 1 else ", "
        if len(head) + len(lines[-1] + text) > WIDTH:
            lines.append("")
        lines[-1] += text
    written = None if inspect.isclass(what) else ast.parse(inspect.getsource(what)).body[0].returns
    returns = "" if written is None else f" -> {ast.unparse(written)}"
    return head + ("\n" + " " * len(head)).join(line.rstrip() for line in lines) + ")" + returns


def shown(value: object) -> str:
    """A default value; "..." where it is an object of its own."""
    return repr(value) if value is None or isinstance(value, (bool, int, float, str, tuple)) else "..."


def members(what: type) -> list[str]:
    """Methods and properties that a class itself describes, a line each."""
    found = []
    for name, member in vars(what).items():
        if name.startswith("_") or not (callable(member) or isinstance(member, (property, classmethod))):
            continue
        text = inspect.getdoc(getattr(what, name) if isinstance(member, classmethod) else member)
        if text:
            call = "" if isinstance(member, property) else "()"
            found.append(f"* `{name}{call}`: {' '.join(text.partition(chr(10) * 2)[0].split())}")
    return found


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    PAGE.write_text(page(), encoding="utf-8")
