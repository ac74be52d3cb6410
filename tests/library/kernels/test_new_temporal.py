# SPDX-License-Identifier: GPL-3.0-or-later
"""A new temporal opacity is its dataclass, its equation for kernels and its equation for shaders: three files, tried on a copy."""
from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import fastgs_blender

PACKAGE = Path(fastgs_blender.__file__).parent
EDITS = {
    "model/temporal.py": ("KINDS = {cls.name: cls for cls in (Always, Radial, Window, WindowedRadial)}", '''
@dataclass(frozen=True)
class Flat:
    """exp(-(t - begin)), whatever comes before.  Columns: begin."""

    name: ClassVar[str] = "flat"
    code: ClassVar[int] = 4
    width: ClassVar[int] = 1
    logarithms: ClassVar[tuple[bool, ...]] = (False,)

    def factor(self, t, mu_tau, parameters):
        return np.exp(-np.maximum(t - np.asarray(parameters[:, 0], np.float64), 0))

    def span(self, visible, mu_tau, parameters):
        return Span(np.zeros(len(mu_tau)), parameters[:, 0] + visible)


KINDS = {cls.name: cls for cls in (Always, Radial, Window, WindowedRadial, Flat)}'''),
    "kernels/cpu/temporal.py": ("    return 1.0\n", "    if code == 4:\n        return exp(-max(t - p[n, 0], 0.0))\n    return 1.0\n"),
    "kernels/equations/temporal.wgsl": ("    return 1.0;\n", '''    if (kind == {TEMPORAL_FLAT}) {
        return exp(-max(t - p.x, 0.0));
    }
    return 1.0;
'''),
}
TRY = """
import numpy as np
import fastgs_blender as fg
from fastgs_blender.kernels.cpu.splats import project_instances
from fastgs_blender.kernels.cpu import raster
from fastgs_blender.kernels.equations import text
from fastgs_blender.kernels.gpu import shaders
from fastgs_blender.model.temporal import temporal_by_name
from fastgs_blender.rendering import oracle
from fastgs_blender.rendering.instances import Instance
from fastgs_blender.rendering.layout import Layout

rng, n, camera = np.random.default_rng(1), 20, fg.Camera(64, 48, 50, 50, 32, 24, np.eye(4))
arrays = dict(position=rng.uniform(-1, 1, (n, 3)) + (0, 0, 4), rotation=rng.normal(size=(n, 4)), scale=rng.normal(-2, 0.3, (n, 3)),
              opacity=rng.normal(1, 1, n), features=rng.uniform(0, 1, (n, 3)), temporal=rng.uniform(0, 1, (n, 1)))
model = fg.GaussianModel(**arrays, temporal_kind=temporal_by_name("flat"))
instance = Instance(model, np.eye(4), 0.6).viewed(camera)
layout = Layout([instance], False)
exact, splats = oracle.project(instance, camera, layout), project_instances([instance], camera, layout)
found = np.exp2(splats.attributes[splats.index, raster.LOG2_OPACITY])
assert len(found) == len(exact.opacity) > 10
np.testing.assert_allclose(found, exact.opacity, rtol=1e-5)
assert np.ptp(model.temporal_kind.factor(0.6, model.mu_tau, model.temporal)) > 0.2
for shader in (shaders.source("project", BENDS=True), text.glsl("temporal")):
    assert "kind == 4" in shader and "exp(-max(t - p.x, 0.0))" in shader
"""


@pytest.mark.slow
def test_three_files_are_all_that_a_new_kind_touches(tmp_path):
    shutil.copytree(PACKAGE, tmp_path / "fastgs_blender", ignore=shutil.ignore_patterns("__pycache__"))
    assert len(EDITS) <= 6
    for name, (old, new) in EDITS.items():
        file = tmp_path / "fastgs_blender" / name
        before = file.read_text("utf-8")
        assert before.count(old) == 1, name
        file.write_text(before.replace(old, new), "utf-8")
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "FASTGS_CACHE_DIR": str(tmp_path / "cache")}
    done = subprocess.run([sys.executable, "-c", TRY], env=environment, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
