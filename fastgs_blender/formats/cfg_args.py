# SPDX-License-Identifier: GPL-3.0-or-later
"""`cfg_args`, the file in which trainers of the INRIA family leave their settings: one printed Namespace(...)."""
import ast
from pathlib import Path

from ..util.errors import FastGSError
from ..util.reading import open_file

MAX_SIZE = 1 << 16


def find(model_file: Path) -> Path | None:
    """The cfg_args of <model>/point_cloud/iteration_<n>/point_cloud.ply: up to three folders above the file."""
    folder = model_file.absolute().parent
    for _ in range(4):
        if (folder / "cfg_args").is_file():
            return folder / "cfg_args"
        folder = folder.parent
    return None


def read(path: Path) -> dict:
    """Its settings, those that are literals.  Parsed, never evaluated; raises FastGSError for anything but a Namespace."""
    try:
        with open_file(path) as stream:
            data = stream.read(MAX_SIZE + 1)
        if len(data) > MAX_SIZE:
            raise ValueError("too long")
        call = ast.parse(data.decode("utf-8").strip(), mode="eval").body
        if not (isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "Namespace" and not call.args):
            raise ValueError("no Namespace")
    except (OSError, ValueError, SyntaxError, RecursionError, MemoryError):  # Python's parser says MemoryError of deep brackets
        raise FastGSError(f"{path} is not the printed Namespace(...) that trainers write") from None
    return {k.arg: value[0] for k in call.keywords if k.arg and (value := _literal(k.value))}


def beside(model_file: Path) -> dict:
    """The settings in the cfg_args of a model's file; none where there is no such file."""
    path = find(model_file)
    return read(path) if path else {}


def number(settings: dict, key: str, default: float, least: float, most: float) -> float:
    """A setting that is a number within bounds; else the default."""
    value = settings.get(key)
    return float(value) if isinstance(value, (int, float)) and least <= value <= most else default


def _literal(node: ast.expr) -> tuple:
    """The value of a number, text, or list of such, in a tuple; empty for anything else."""
    try:
        return (ast.literal_eval(node),)
    except (ValueError, TypeError, SyntaxError, RecursionError, MemoryError):
        return ()
