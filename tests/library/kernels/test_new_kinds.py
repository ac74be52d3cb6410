# SPDX-License-Identifier: GPL-3.0-or-later
"""A new temporal opacity touches three files, and a new appearance that depends on the direction five: tried on a copy."""
from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import fastgs_blender

PACKAGE = Path(fastgs_blender.__file__).parent
TEMPORAL = {
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
APPEARANCE = {
    "model/appearance.py": ("APPEARANCES = {cls.name: cls for cls in (RGB, SH, Features, Changing)}", '''
@dataclass(frozen=True)
class Tilted(Appearance):
    """rgb + slope . direction.  Columns: r, g, b, slope (3)."""

    name: ClassVar[str] = "tilted"
    code: ClassVar[int] = 3
    width: ClassVar[int] = 6

    def seen(self, features, directions):
        return features[:, :3] + np.einsum("mi,mi->m", features[:, 3:], directions)[:, None]


APPEARANCES = {cls.name: cls for cls in (RGB, SH, Features, Changing, Tilted)}'''),
    "kernels/cpu/appearance.py": (
        "dx, dy, dz, terms, out)\n", '''dx, dy, dz, terms, out)
    if code == 3:
        dx, dy, dz, _ = direction_of(px, py, pz, eye, orthographic)
        tilt = features[n, 3] * dx + features[n, 4] * dy + features[n, 5] * dz
        out[0], out[1], out[2] = features[n, 0] + tilt, features[n, 1] + tilt, features[n, 2] + tilt
''',
        "    return gx, gy, gz\n", '''    if code == 3:
        dx, dy, dz, distance = direction_of(px, py, pz, eye, orthographic)
        whole = 0.0
        for c in range(3):
            out[n, c] = g[row, channel + c]
            whole += g[row, channel + c]
        out[n, 3], out[n, 4], out[n, 5] = whole * dx, whole * dy, whole * dz
        if not orthographic:
            tilt = features[n, 3] * dx + features[n, 4] * dy + features[n, 5] * dz
            gx, gy, gz = (whole * (features[n, 3] - tilt * dx) / distance, whole * (features[n, 4] - tilt * dy) / distance,
                          whole * (features[n, 5] - tilt * dz) / distance)
    return gx, gy, gz
'''),
    "kernels/gpu/wgsl/appearance.wgsl": (
        """    } else {
        for (var c = 0u; c < appearance_numbers(); c++) {
            out[c]""", '''    } else if view.kinds.y == {APPEARANCE_TILTED}u {
        let slope = vec3f(feature(n, 3u, delta), feature(n, 4u, delta), feature(n, 5u, delta));
        let tilt = dot(slope, normalize(seen_along(position)));
        for (var c = 0u; c < 3u; c++) {
            out[c] = feature(n, c, delta) + tilt;
        }
    } else {
        for (var c = 0u; c < appearance_numbers(); c++) {
            out[c]'''),
    "kernels/gl/splat.py": (
        "  return harmonic_colours ? max", '''  if (whole(instance_texel(o, INSTANCE_GEOMETRY).w) == 3) {
    return sum + vec3(dot(colour_texel(at + 1).xyz, d));
  }
  return harmonic_colours ? max'''),
    "training/core/settings.py": ('"rgb", "sh1"', '"rgb", "tilted", "sh1"'),
}
TRY = """
import numpy as np
import fastgs_blender as fg
from fastgs_blender.kernels.cpu.rasterise import RasterGradients
from fastgs_blender.kernels.cpu.splats import project_backward, project_instances
from fastgs_blender.kernels.cpu import raster
from fastgs_blender.kernels.equations import text
from fastgs_blender.kernels.gl import model_texels, splat
from fastgs_blender.kernels.gpu import shaders
from fastgs_blender.model.appearance import APPEARANCES
from fastgs_blender.model.temporal import temporal_by_name
from fastgs_blender.rendering import oracle
from fastgs_blender.rendering.instances import Instance
from fastgs_blender.rendering.layout import Layout
from fastgs_blender.training.core.settings import Settings

rng, n, camera = np.random.default_rng(1), 20, fg.Camera(64, 48, 50, 50, 32, 24, np.eye(4))
arrays = dict(position=rng.uniform(-1, 1, (n, 3)) + (0, 0, 4), rotation=rng.normal(size=(n, 4)), scale=rng.normal(-2, 0.3, (n, 3)),
              opacity=rng.normal(1, 1, n), features=rng.uniform(0, 1, (n, 6)), temporal=rng.uniform(0, 1, (n, 1)))


def projected(camera=camera, **changed):
    model = fg.GaussianModel(**arrays | changed, temporal_kind=temporal_by_name("flat"), appearance=APPEARANCES["tilted"]())
    instance = Instance(model, np.eye(4), 0.6).viewed(camera)
    layout = Layout([instance], False)
    return model, instance, layout, project_instances([instance], camera, layout)


for each in camera, fg.Camera(64, 48, 12, 12, 32, 24, np.eye(4), orthographic=True):
    model, instance, layout, splats = projected(each)
    exact = oracle.project(instance, each, layout)
    found = splats.attributes[splats.index]
    assert len(found) == len(exact.opacity) > 10
    np.testing.assert_allclose(np.exp2(found[:, raster.LOG2_OPACITY]), exact.opacity, rtol=1e-5)
    np.testing.assert_allclose(found[:, raster.CHANNEL:raster.CHANNEL + 3], exact.channels[:, :3], rtol=1e-5)
assert np.ptp(model.temporal_kind.factor(0.6, model.mu_tau, model.temporal)) > 0.2
assert np.ptp(exact.channels[:, 0] - model.features[splats.source[splats.index], 0]) > 0.01

model, instance, layout, splats = projected()
weights, rows = rng.normal(size=(n, 3)).astype(np.float32), len(splats.source)
slopes = RasterGradients(np.zeros((rows, 5)), np.zeros(rows, np.float32), np.zeros((rows, 3), np.float32), np.zeros((rows, 2), np.float32))
slopes.channels[splats.index] = weights[splats.source[splats.index]]
gradients = project_backward(instance, camera, layout, splats, slopes)
for name in "features", "position":
    step = rng.normal(size=arrays[name].shape)

    def loss(share):
        splats = projected(**{name: arrays[name] + share * step})[3]
        shown = splats.attributes[splats.index, raster.CHANNEL:raster.CHANNEL + 3]
        return (shown.astype(np.float64) * weights[splats.source[splats.index]]).sum()

    seen = (gradients[name].astype(np.float64) * step).sum()
    np.testing.assert_allclose(seen, (loss(1e-3) - loss(-1e-3)) / 2e-3, rtol=1e-2)

layout = model_texels.layout_of(model)
out = np.zeros((n, layout.colour, 4))
model_texels.write_colour(model, out)
np.testing.assert_array_equal(out[..., :3].reshape(n, 6), model.features)
for shader in (shaders.source("project", BENDS=True), text.glsl("temporal")):
    assert "kind == 4" in shader and "exp(-max(t - p.x, 0.0))" in shader
assert "view.kinds.y == 3u" in shaders.source("project", BENDS=True) and "return sum + vec3(dot" in splat.VERTEX
assert Settings(appearance="tilted").appearance == "tilted"
"""


@pytest.mark.slow
def test_few_files_are_all_that_new_kinds_touch(tmp_path):
    shutil.copytree(PACKAGE, tmp_path / "fastgs_blender", ignore=shutil.ignore_patterns("__pycache__"))
    assert len(TEMPORAL) <= 6
    assert len(APPEARANCE) <= 6
    for name, changes in (*TEMPORAL.items(), *APPEARANCE.items()):
        file = tmp_path / "fastgs_blender" / name
        for old, new in zip(changes[::2], changes[1::2]):
            before = file.read_text("utf-8")
            assert before.count(old) == 1, name
            file.write_text(before.replace(old, new), "utf-8")
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "FASTGS_CACHE_DIR": str(tmp_path / "cache")}
    done = subprocess.run([sys.executable, "-c", TRY], env=environment, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
