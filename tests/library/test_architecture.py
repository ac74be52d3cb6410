# SPDX-License-Identifier: GPL-3.0-or-later
"""The rules of the house: who may import whom, and what every source file begins with."""
from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ORDER = ("fastgs_blender", "scene", "engine", "operators", "ui")
"""A package imports itself and those before it; the root __init__.py imports them all."""
BLENDERS = {"bpy", "bmesh", "gpu", "gpu_extras", "mathutils", "bpy_extras", "bl_ui", "addon_utils", "blf", "imbuf", "aud"}


def imported(path: str, source: str):
    """The modules that the file `path` (relative to the root) imports: (dots, name) for each."""
    for node in ast.walk(ast.parse(source, path)):
        if isinstance(node, ast.Import):
            yield from ((0, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from ((node.level, node.module or alias.name) for alias in node.names)


def violations(path: str, source: str) -> set[str]:
    """What is wrong with the imports of a file of the extension."""
    package = Path(path).parent.parts
    own = ORDER.index(package[0]) if package else len(ORDER)
    wrong = set()
    for dots, name in imported(path, source):
        first = name.partition(".")[0]
        if not dots:
            if first in ORDER:
                wrong.add(f"{path}: {first} by an absolute import")
            if own == 0 and first in BLENDERS:
                wrong.add(f"{path}: {first} in the library")
            continue
        base = package[:len(package) - dots + 1]
        if dots > len(package) + 1:
            wrong.add(f"{path}: out of the extension")
        elif not base and first in ORDER and ORDER.index(first) > own:
            wrong.add(f"{path}: {first}, against the order")
    return wrong


def extension_files():
    return ["__init__.py", *(str(p.relative_to(ROOT)) for package in ORDER for p in sorted((ROOT / package).rglob("*.py")))]


def test_extension_follows_the_import_rules():
    files = extension_files()
    assert any(f.startswith("engine") for f in files)
    assert not set().union(*(violations(f, (ROOT / f).read_text("utf-8")) for f in files))


@pytest.mark.parametrize(("path", "source", "good"), [
    ("fastgs_blender/a.py", "import numpy\nfrom .model import GaussianModel", True),
    ("fastgs_blender/kernels/a.py", "from ..model import GaussianModel\nfrom . import jit", True),
    ("fastgs_blender/a.py", "def f():\n    import bpy.types", False),
    ("fastgs_blender/a.py", "from mathutils import Matrix", False),
    ("fastgs_blender/a.py", "import gpu", False),
    ("fastgs_blender/a.py", "from fastgs_blender import model", False),
    ("fastgs_blender/a.py", "from ..engine import x", False),
    ("fastgs_blender/kernels/a.py", "from ... import engine", False),
    ("engine/a.py", "import bpy\nfrom .. import fastgs_blender as fg\nfrom ..fastgs_blender.model.gaussians import Clip", True),
    ("engine/a.py", "from ..operators import x", False),
    ("engine/a.py", "from .. import ui", False),
    ("operators/a/b.py", "from ...engine import x", True),
    ("operators/a.py", "from ...engine import x", False),
    ("operators/a.py", "from engine import x", False),
    ("ui/a.py", "from ..operators import x", True),
    ("__init__.py", "from . import engine, operators, scene, ui", True),
    ("scene/a.py", "from ..engine import x", False),
    ("engine/a.py", "from ..scene import x", True),
    ("__init__.py", "from .. import engine", False),
])
def test_the_import_rules_themselves(path, source, good):
    assert (not violations(path, source)) == good


def test_every_source_file_names_its_licence():
    folders = (*ORDER, "tests", "tools", "benchmarks")
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
