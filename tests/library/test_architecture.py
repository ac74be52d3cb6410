# SPDX-License-Identifier: GPL-3.0-or-later
"""The rules of the house: who may import whom, how long a file may be, and what every source file begins with."""
from __future__ import annotations

import ast
import subprocess
import sys
from functools import cache
from pathlib import PurePosixPath

import pytest
from imports import PACKAGES, ROOT, called, circles, extension_files, imports, operators, parsed, targets

ROOMS = ("util", "model", "cameras", "rendering", "kernels", "selecting", "stitching", "formats", "surfaces", "captures", "evaluation",
         "training/core", "training/initial", "training/run", "jobs", "checks", "commands", "")
"""The library's folders in their order: a room imports itself and those before it.  "": the modules at the library's top."""
DOORS = {
    "fastgs_blender/util/backends.py": "loads a rendering backend by its name",
    "fastgs_blender/jobs/child.py": "starts the command line in a process of its own",
}
"""Modules that load another by its name, against the order, and why.  They are no exception from the rule against circles."""
BACKENDS = ("fastgs_blender/kernels/cpu/", "fastgs_blender/kernels/gpu/")
BACKEND_USERS = {
    "fastgs_blender/captures/pixels/framefiles.py": {"cache"},  # decoded frames are kept beside compiled kernels
    "fastgs_blender/formats/packing.py": {"jit"},  # unpacks LZ4 byte by byte, which Python alone is too slow for
    "fastgs_blender/selecting/grow.py": {"walk"},  # a graph, not a picture
    "fastgs_blender/selecting/spans.py": {"walk"}, "fastgs_blender/selecting/joins.py": {"walk"},
    "fastgs_blender/selecting/moving.py": {"walk"},
    "fastgs_blender/stitching/skins.py": {"cells"}, "fastgs_blender/stitching/starts.py": {"cells"},  # a surface, not a picture
    "fastgs_blender/formats/rounding.py": {"jit"},  # rounds each number by the one before
    "scene/settings.py": {"cache"},  # Blender's folder for caches
    "engine/diagnostics.py": {"cache"},  # what is compiled
    "engine/compiling.py": {"aside", "cache"},  # compiles the kernels ahead, in a process of its own
    "operators/maintenance.py": {"cache"}, "ui/preferences.py": {"cache"},  # the cache's size; clearing it
}
"""Modules outside kernels/ that import one of a backend's modules, which of them, and why.  All others ask util/backends.py."""
BLENDERS = {"bpy", "bmesh", "gpu", "gpu_extras", "mathutils", "bpy_extras", "bl_ui", "addon_utils", "blf", "imbuf", "aud"}
LINES = 400
"""The most lines of a Python file."""


def rank(path: str) -> tuple[int, int]:
    """Where a module stands in the order: package, room."""
    package, _, rest = path.partition("/")
    if package not in PACKAGES:
        return len(PACKAGES), 0
    if package != "fastgs_blender":
        return PACKAGES.index(package), 0
    return 0, next(i for i, room in enumerate(ROOMS) if rest.startswith(room and room + "/"))


def against_the_order(path: str, source: str, files: dict[str, str]) -> set[str]:
    """The modules that `path` imports, or whose operators it calls, though they come after it."""
    others = targets(path, source, files) | called(path, source, operators(files))
    return set() if path in DOORS else {f"{path}: {other}" for other in others if rank(other) > rank(path)}


def beside_the_protocol(path: str, source: str, files: dict[str, str]) -> set[str]:
    """A backend's own modules that a module outside kernels/ imports, and that BACKEND_USERS does not allow it."""
    if path.startswith("fastgs_blender/kernels/") or path in DOORS:
        return set()
    used = {other for other in targets(path, source, files) if other.startswith(BACKENDS)}
    return {f"{path}: {other}" for other in used if PurePosixPath(other).stem not in BACKEND_USERS.get(path, ())}


def foreign(path: str, source: str) -> set[str]:
    """Imports that break the extension when Blender loads it, and Blender in the library."""
    wrong, depth = set(), len(PurePosixPath(path).parent.parts)
    for dots, module, _ in imports(source):
        first = module.partition(".")[0]
        if dots > depth + 1:
            wrong.add(f"{path}: out of the extension")
        if not dots and first in PACKAGES:
            wrong.add(f"{path}: {first} by an absolute import")
        if not dots and first in BLENDERS and path.startswith("fastgs_blender/"):
            wrong.add(f"{path}: {first} in the library")
    return wrong


@pytest.fixture(scope="module")
def files():
    return extension_files()


def test_the_library_knows_no_blender_and_imports_are_relative(files):
    assert not set().union(*(foreign(path, source) for path, source in files.items()))


@pytest.mark.slow
def test_imports_and_operators_follow_the_order(files):
    assert any(path.startswith("engine/") for path in files)
    assert not set().union(*(against_the_order(path, source, files) for path, source in files.items()))


def test_a_backend_is_reached_through_its_protocol_alone(files):
    assert not set().union(*(beside_the_protocol(path, source, files) for path, source in files.items()))
    for path, source in (("fastgs_blender/training/core/a.py", "def f():\n    from ...kernels.cpu import loss"),
                         ("engine/a.py", "from ..fastgs_blender.kernels.cpu.backend import BACKEND"),
                         ("fastgs_blender/training/core/a.py", "from ...kernels.gpu import lists")):
        assert beside_the_protocol(path, source, {**files, path: source})


def test_every_folder_of_the_library_has_its_place_in_the_order(files):
    folders = {str(PurePosixPath(path).relative_to("fastgs_blender").parent) for path in files if path.startswith("fastgs_blender/")}
    assert all(any(folder.startswith(room) for room in ROOMS[:-1]) for folder in folders - {".", "training"})


def test_no_imports_go_in_a_circle(files):
    found = circles({path: targets(path, source, files) for path, source in files.items()})
    assert not found


@cache
def defined(source: str) -> set[str]:
    """The names that a module's top level defines or imports."""
    statements = [node for node in ast.walk(parsed(source)) if isinstance(node, ast.stmt) and node.col_offset == 0]
    names = {node.name for node in statements if isinstance(node, (ast.FunctionDef, ast.ClassDef))}
    names |= {(alias.asname or alias.name).partition(".")[0] for node in statements if isinstance(node, (ast.Import, ast.ImportFrom))
              for alias in node.names}
    assigned = [node for node in statements if isinstance(node, (ast.Assign, ast.AnnAssign))]
    return names | {name.id for node in assigned for name in ast.walk(node) if isinstance(name, ast.Name)}


def missing(folder: str, source: str, others: dict[str, str]) -> set[str]:
    """Names that a script imports from one beside it, or from those shared by tests, though that one does not define them."""
    found = set()
    for _, module, name in imports(source):
        path = next((path for path in (f"{folder}/{module}.py", f"tests/shared/{module}.py") if path in others), None)
        if path and name and name not in defined(others[path]):
            found.add(f"{path}: {name}")
    return found


@pytest.mark.slow
def test_scripts_import_what_their_neighbours_define():
    """Stories in real Blenders run long after this test: a name that was moved is found here."""
    paths = [path for folder in ("tests", "tools", "benchmarks", "examples") for path in (ROOT / folder).rglob("*.py")]
    others = {path.relative_to(ROOT).as_posix(): path.read_text("utf-8") for path in paths}
    assert any(path.startswith("tests/blender/") for path in others)
    for path, source in others.items():
        assert not missing(str(PurePosixPath(path).parent), source, others), path
    assert missing("tests/blender", "from window import shot, doors", others) == {"tests/blender/window.py: doors"}


def test_no_file_is_long():
    folders = (*PACKAGES, "tests", "tools", "benchmarks", "examples")
    paths = [ROOT / "__init__.py", *(path for folder in folders for path in (ROOT / folder).rglob("*.py"))]
    long = {path.relative_to(ROOT).as_posix() for path in paths if len(path.read_text("utf-8").splitlines()) > LINES}
    assert not long


@pytest.mark.parametrize(("path", "source", "good"), [
    ("fastgs_blender/a.py", "import numpy\nfrom .model import gaussians", True),
    ("fastgs_blender/kernels/a.py", "from ..model.gaussians import GaussianModel\nfrom . import cpu", True),
    ("fastgs_blender/kernels/a.py", "def f():\n    from ..formats import load", False),
    ("fastgs_blender/model/a.py", "from ..cameras.camera import Camera", False),
    ("fastgs_blender/model/a.py", "from .. import load", False),
    ("fastgs_blender/training/core/a.py", "from ..initial.starting_points import thinned", False),
    ("fastgs_blender/training/initial/a.py", "from ..core import model", True),
    ("fastgs_blender/util/a.py", "import importlib\nimportlib.import_module('..model.motion', __package__)", False),
    ("fastgs_blender/util/a.py", "from importlib import import_module\nROOM = 'model.motion'\nimport_module(ROOM)", False),
    ("fastgs_blender/util/a.py", "import importlib\nimportlib.import_module(f'..formats.{name}', __package__)", False),
    ("fastgs_blender/util/a.py", "TITLE = 'fastgs_blender.cli'", True),
    ("fastgs_blender/util/a.py", "from ...engine import handlers", False),
    ("fastgs_blender/a.py", "def f():\n    import bpy.types", False),
    ("fastgs_blender/a.py", "from mathutils import Matrix", False),
    ("fastgs_blender/a.py", "import gpu", False),
    ("fastgs_blender/a.py", "from fastgs_blender import model", False),
    ("fastgs_blender/a.py", "from ..engine import handlers", False),
    ("fastgs_blender/kernels/a.py", "from ... import engine", False),
    ("engine/a.py", "import bpy\nfrom .. import fastgs_blender as fg\nfrom ..fastgs_blender.model.gaussians import Clip", True),
    ("engine/a.py", "from ..operators import train", False),
    ("engine/a.py", "from .. import ui", False),
    ("operators/a/b.py", "from ...engine import handlers", True),
    ("operators/a.py", "from ...engine import handlers", False),
    ("operators/a.py", "from engine import handlers", False),
    ("operators/a.py", "import bpy\nbpy.ops.fastgs.train()", True),
    ("ui/a.py", "from ..operators import train\nlayout.operator('fastgs.train')", True),
    ("__init__.py", "from . import engine, operators, scene, ui", True),
    ("scene/a.py", "from ..engine import handlers", False),
    ("scene/a.py", "import bpy\nbpy.ops.fastgs.train()", False),
    ("scene/a.py", "import bpy\nbpy.ops.object.mode_set(mode='OBJECT')", True),
    ("engine/a.py", "layout.operator('fastgs.train')", False),
    ("engine/a.py", "from ..scene import objects", True),
    ("__init__.py", "from .. import engine", False),
])
def test_the_import_rules_themselves(files, path, source, good):
    assert (not foreign(path, source) | against_the_order(path, source, {**files, path: source})) == good


def test_circles_are_found_through_lazy_imports_packages_and_names():
    sources = {
        "fastgs_blender/__init__.py": "from .a import x", "fastgs_blender/a.py": "def f():\n    from . import b",
        "fastgs_blender/b.py": "import importlib\nWHERE = '.c.d'", "fastgs_blender/c/__init__.py": "",
        "fastgs_blender/c/d.py": "def f():\n    importlib = 1\n    from .. import __version__", "fastgs_blender/e.py": "from . import a"}
    sources["fastgs_blender/b.py"] += "\nimportlib.import_module(WHERE, __package__)"
    graph = {path: targets(path, source, sources) for path, source in sources.items()}
    assert circles(graph) == [{"fastgs_blender/__init__.py", "fastgs_blender/a.py", "fastgs_blender/b.py", "fastgs_blender/c/d.py"}]


def test_every_source_file_names_its_licence():
    folders = (*PACKAGES, "tests", "tools", "benchmarks")
    files = [p for folder in folders for pattern in ("*.py", "*.sh") for p in (ROOT / folder).rglob(pattern)]
    files += [ROOT / "__init__.py", ROOT / "Makefile", ROOT / ".ci" / "run", ROOT / "pyproject.toml"]
    bare = [str(p.relative_to(ROOT)) for p in files
            if "# SPDX-License-Identifier: GPL-3.0-or-later" not in p.read_text("utf-8").splitlines()[:2]]
    assert not bare


RENDERING = """
import sys

class Refuse:
    def find_spec(self, name, path=None, target=None):
        assert name.partition(".")[0] not in ("torch", "bpy", "gpu", "mathutils"), name + " was imported"

sys.meta_path.insert(0, Refuse())
import fastgs_blender as fg
assert not {"numba", "tqdm", "PIL", "OpenEXR"} & set(sys.modules), "importing the library imports what only some calls need"
import numpy as np
model = fg.GaussianModel(position=np.zeros((1, 3)), rotation=np.ones((1, 4)), scale=np.zeros((1, 3)), opacity=np.ones(1),
                         features=np.ones((1, 3)))
camera = fg.Camera(8, 8, 8, 8, 4, 4, np.eye(4) + [[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 5], [0, 0, 0, 0]])
for backend in ("reference", "cpu"):
    assert fg.render(model, camera, backend=backend)["alpha"].max() > 0.1
"""


def test_rendering_needs_neither_torch_nor_blender_and_the_library_starts_light():
    result = subprocess.run([sys.executable, "-c", RENDERING], cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
