# SPDX-License-Identifier: GPL-3.0-or-later
"""The library's public face: all of it is described, with an example that runs, and docs/api.md says the same."""
from __future__ import annotations

import ast
import importlib.util
import inspect
import pydoc
import re
import shutil
import subprocess
import sys
import textwrap
import warnings
from pathlib import Path

import numpy as np
import pytest
from toy_captures import write_capture, write_examples

import fastgs_blender as fg
from fastgs_blender.kernels.protocol import PictureBackend, TrainingBackend

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def api_docs():
    spec = importlib.util.spec_from_file_location("api_docs", ROOT / "tools" / "api_docs.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def example(name: str) -> str:
    return textwrap.dedent(inspect.getdoc(getattr(fg, name)).partition("\n\nExample:\n")[2]).strip()


def test_every_public_name_has_its_place():
    """The three lists of the face are one: __all__, the modules that __getattr__ imports, and what type checkers see."""
    tree = ast.parse((ROOT / "fastgs_blender" / "__init__.py").read_text("utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    shown = {node.module: {alias.name for alias in node.names} for node in block.body}
    assert shown == {module: set(names.split()) for module, names in fg.PLACES.items()}
    assert sorted(fg.__all__) == sorted({*(name for names in shown.values() for name in names), "FastGSError", "LossWarning"})
    assert all(getattr(fg, name) for name in fg.__all__) and set(fg.__all__) <= set(dir(fg))
    with pytest.raises(AttributeError, match="nonsense"):
        fg.nonsense  # noqa: B018


def test_importing_the_library_imports_no_room_of_it():
    """Neither NumPy nor any module but those that the command line needs first; a name or a room is imported when it is used."""
    code = ("import sys, fastgs_blender as fg; assert 'numpy' not in sys.modules; "
            "print(*(name for name in sys.modules if name.startswith('fastgs_blender.') and not name.startswith('fastgs_blender.util'))); "
            "assert fg.formats.readable() and fg.Clip(3).frame_count == 3")
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == ""


def test_the_page_is_current(api_docs):
    assert (ROOT / "docs" / "api.md").read_text("utf-8") == api_docs.page(), "`make api-docs` writes it anew"


def test_everything_is_on_the_page_and_has_an_example(api_docs):
    listed = [name for names in api_docs.GROUPS.values() for name in names]
    assert sorted(listed) == sorted(fg.__all__) and len(set(listed)) == len(listed)
    made = {"Alignment", "BakeReport", "Capture", "CheckReport", "Cleaning", "Grade", "Loop", "MovingMesh", "Similarity",
            "View", "Slice", "Sequence", "Chapters"}  # by other members
    assert not [name for name in fg.__all__ if f"fg.{'' if name in made else name}" not in example(name)]
    helped = pydoc.plain(pydoc.render_doc(fg))
    assert all(re.search(rf"\b{name}\b", helped) for name in fg.__all__) and "examples/fireside.safetensors" in helped


@pytest.mark.slow
def test_the_examples_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_examples(Path("examples"))
    write_capture(Path("my-capture"), frames=16)  # clocks are compared along them
    positions = np.tile(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]), (3, 1, 1)) + np.arange(3)[:, None, None]
    names = {"fg": fg, "np": np, "warnings": warnings, "positions": positions, "triangles": np.array([[0, 1, 2], [1, 3, 2]])}
    few = ', init="file", iterations=2, init_points=50, preview_every=0'
    overview = "\n".join(line.strip() for line in inspect.getdoc(fg).split("\n\n")[1:-1] for line in line.splitlines())
    model, camera = fg.load("examples/fireside.safetensors"), fg.load_cameras("examples/cameras.json")[4].camera
    frozen = fg.freeze(model.take(slice(0, 50)), 0)
    for i in range(2):
        fg.save(frozen, f"still_{i:04d}.ply")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", fg.LossWarning)
        for code in (overview, *map(example, fg.__all__)):
            code = re.sub(r'preset="draft"(, iterations=500)?', f'preset="draft"{few}', code)
            code = code.replace("fg.make_mesh(model, t=0.25)", "fg.make_mesh(model, t=0.25, detail=48)")
            shutil.rmtree("run", ignore_errors=True) if "fg.train" in code else None
            exec(code, {**names, "model": model, "camera": camera})  # noqa: S102 (our own docstrings)
    assert Path("copy.ply").exists() and Path("cameras.json").exists() and len(fg.load("run/model.safetensors"))


def functions(of: str, what) -> list:
    """(name, function) of a public function, or of a class's public methods and properties."""
    own = vars(what) if inspect.isclass(what) else {}
    found = [getattr(each, "fget", None) or getattr(each, "__func__", each) for key, each in own.items() if not key.startswith("_")]
    return [(f"{of}.{each.__name__}", each) for each in ([what] if inspect.isfunction(what) else found) if inspect.isfunction(each)]


PUBLIC = [pair for name in fg.__all__ for pair in functions(name, getattr(fg, name))]


def test_everything_public_is_annotated():
    """For type checkers of other projects: py.typed promises it; `make lint` checks that the annotations are right."""
    assert (ROOT / "fastgs_blender" / "py.typed").exists()
    bare = []
    for name, function in PUBLIC:
        signature = inspect.signature(function)
        missing = [key for key, parameter in signature.parameters.items() if parameter.annotation is parameter.empty and key not in
                   ("self", "cls")]
        if missing or signature.return_annotation is signature.empty:
            bare.append(f"{name}{missing}")
    assert not bare


def test_every_array_has_a_shape():
    """The docstring of what takes or gives arrays, public or a backend's operation, has as many shapes, as in [N, 3]."""
    operations = [pair for each in (PictureBackend, TrainingBackend) for pair in functions(each.__name__, each)]
    without = []
    for name, function in [*PUBLIC, *operations]:
        kinds = [str(kind) for kind in inspect.get_annotations(function).values()]
        arrays = sum(bool(re.search(r"\b(Array|ArrayLike|ndarray)\b", kind)) for kind in kinds)
        owner = getattr(fg, name.partition(".")[0], None)
        text = inspect.getdoc(getattr(owner, function.__name__, function)) or ""  # perhaps inherited
        shapes = len(re.findall(r"\[[^\[\]\n\"]+\]", text))
        if shapes < arrays:
            without.append(f"{name}: {arrays} arrays, {shapes} shapes")
    assert not without


def test_several_results_have_names():
    """And are unpacked like a tuple."""
    model, report = baked = fg.bake(np.tile(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), (3, 1, 1)), [[0, 1, 2]], count=20)
    assert baked.model is model and baked.report is report
    rays = fg.Camera(8, 6, 5.0, 5.0, 4.0, 3.0, np.eye(4)).rays(np.eye(4))
    assert rays.centre.shape == (3,) and rays.directions.shape == (6, 8, 3)
    span = fg.Radial().span(np.ones(2), np.zeros(2), np.zeros((2, 1)))
    assert (span.begin < span.end).all()
