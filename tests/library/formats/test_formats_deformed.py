# SPDX-License-Identifier: GPL-3.0-or-later
"""Networks that move Gaussians against their own formulas, by torch in float64: Deformable-3DGS and 4DGaussians.

Transcribed from
* ingra14m/Deformable-3D-Gaussians@ac42372: utils/time_utils.py, DeformNetwork, lines 58-129; utils/rigid_utils.py, exp_se3, 60-88;
  gaussian_renderer/__init__.py, 70-89: unit quaternions plus what the network says go to the rasteriser, which does not normalise, see
  kernel_covariance(); files as save_weights() (scene/deform_model.py, 32) and save_ply() (scene/gaussian_model.py, 156) write them.
* hustvl/4DGaussians@843d5ac: scene/deformation.py, lines 66-146; scene/hexplane.py, 19-160; scene/grid.py; utils/graphics_utils.py,
  batch_quaternion_multiply, 109; gaussian_renderer/__init__.py, 97-99: sizes, quaternions and opacities activated after they are moved;
  files as save_deformation() (scene/gaussian_model.py, 246) writes them, folders as scene/__init__.py, 96-104.
"""
from __future__ import annotations

import mutations
import numpy as np
import pytest
import torch
from evaluated import kernel_covariance, unit
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.model.from_frames import one_model

pytestmark = pytest.mark.filterwarnings("ignore::fastgs_blender.LossWarning")
N = 25
nn = torch.nn.functional


def layer(rng, weights, name, out, size, spread=1.0):
    weights[name + ".weight"] = torch.tensor(rng.normal(0, spread / np.sqrt(size), (out, size)), dtype=torch.float32)
    weights[name + ".bias"] = torch.tensor(rng.normal(0, 0.05, out), dtype=torch.float32)


def still(folder, rng):
    folder.mkdir(parents=True)
    model = random_model(rng, N, appearance="sh3", extent=1.5)
    fg.save(model, folder / "point_cloud.ply")
    return model, folder / "point_cloud.ply"


def lin(w, name, x):
    return nn.linear(x, w[name + ".weight"].double(), w[name + ".bias"].double())


def encoded(x, octaves):
    return torch.cat([x] + [f(x * 2.0**k) for k in range(octaves) for f in (torch.sin, torch.cos)], -1)


def deformable(tmp_path, rng, blender, six):
    model, path = still(tmp_path / "point_cloud" / "iteration_9", rng)
    w, time = {}, 30 if blender else 21
    for k in range(8):
        layer(rng, w, f"linear.{k}", 256, 63 + time if k == 0 else 256 + 63 + time if k == 5 else 256, 1.4)
    if blender:
        layer(rng, w, "timenet.0", 256, 13)
        layer(rng, w, "timenet.2", 30, 256)
    for name, out in (("branch_w", 3), ("branch_v", 3)) if six else (("gaussian_warp", 3),):
        layer(rng, w, name, out, 256, 0.3)
    layer(rng, w, "gaussian_rotation", 4, 256, 0.3)
    layer(rng, w, "gaussian_scaling", 3, 256, 0.02)
    (tmp_path / "deform" / "iteration_9").mkdir(parents=True)
    torch.save(w, tmp_path / "deform" / "iteration_9" / "deform.pth")
    return model, path, w


@pytest.mark.parametrize(("blender", "six"), [(False, False), (True, False), (False, True)])
def test_deformable(tmp_path, rng, blender, six):
    model, path, w = deformable(tmp_path, rng, blender, six)
    source = fg.open_source(path)
    for t in (0.0, 0.37, 1.0):
        x = torch.tensor(model.position).double()
        time = torch.full((N, 1), t).double()
        time = lin(w, "timenet.2", torch.relu(lin(w, "timenet.0", encoded(time, 6)))) if blender else encoded(time, 10)
        seen = torch.cat([encoded(x, 10), time], -1)
        h = seen
        for k in range(8):
            h = torch.relu(lin(w, f"linear.{k}", h))
            if k == 4:
                h = torch.cat([seen, h], -1)
        if six:
            axis, slide = lin(w, "branch_w", h), lin(w, "branch_v", h)
            angle = axis.norm(dim=-1, keepdim=True)
            axis, slide = axis / angle + 1e-5, slide / angle + 1e-5
            zero = torch.zeros(N).double()
            cross = torch.stack([zero, -axis[:, 2], axis[:, 1], axis[:, 2], zero, -axis[:, 0], -axis[:, 1], axis[:, 0], zero], -1)
            cross, angle, one = cross.reshape(N, 3, 3), angle[..., None], torch.eye(3).double()
            turn = one + torch.sin(angle) * cross + (1 - torch.cos(angle)) * cross @ cross
            shift = (angle * one + (1 - torch.cos(angle)) * cross + (angle - torch.sin(angle)) * cross @ cross) @ slide[..., None]
            position = (turn @ x[..., None] + shift)[..., 0]
        else:
            position = x + lin(w, "gaussian_warp", h)
        q = nn.normalize(torch.tensor(model.rotation).double()) + lin(w, "gaussian_rotation", h)
        shown, at = source.moment(t)
        s = fg.slice_model(shown, at, cull=False)
        np.testing.assert_allclose(s.position, position.numpy(), atol=1e-4)
        scale = np.exp(model.scale.astype(np.float64)) + lin(w, "gaussian_scaling", h).numpy()
        assert np.ptp(np.linalg.norm(q.numpy(), axis=1)) > 0.2
        covariance = kernel_covariance(scale, q.numpy())
        size = np.linalg.norm(covariance, axis=(1, 2))[:, None, None]
        np.testing.assert_allclose(kernel_covariance(s.scale, s.rotation) / size, covariance / size, atol=1e-4)
        np.testing.assert_allclose(shown.features, model.features, atol=1e-6)


def test_cameras_of_the_capture_lie_beside_it(tmp_path, rng):
    _, path, _ = deformable(tmp_path, rng, False, False)
    (tmp_path / "cfg_args").write_text("Namespace(images='images', resolution=2)")
    fg.save_cameras([fg.Camera(64, 48, 50, 50, 32, 24, np.eye(4))], tmp_path / "cameras.json")
    view, = fg.open_source(path).moment(0.3)[0].surroundings.cameras
    assert (view.width, view.height, view.fx) == (32, 24, 25)


def test_axes_keep_their_order_over_time(tmp_path, rng):
    """Neither sign nor order of axes jumps where two sizes become equal, so that a bake follows them."""
    _, path, _ = deformable(tmp_path, rng, False, False)
    source = fg.open_source(path)
    q = np.array([source.moment(t)[0].rotation for t in np.linspace(0.2, 0.21, 40)])
    turns = np.abs(np.sum(unit(q[1:]) * unit(q[:-1]), 2))
    assert np.quantile(turns, 0.02) > np.cos(np.radians(10) / 2)


def hexplane(tmp_path, rng, off=(), more=(), heads=("pos", "scales", "rotations", "opacity", "shs")):
    model, path = still(tmp_path / "point_cloud" / "iteration_9", rng)
    channels, width, w = 4, 16, {}
    w["grid.aabb"] = torch.tensor([[2.0, 2.1, 1.9], [-2.0, -1.8, -2.2]])
    sizes = (8, 9, 7, 5)
    for scale in range(2):
        full = [s * (1 + scale) for s in sizes[:3]] + [sizes[3]]
        for k, (i, j) in enumerate(((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))):
            w[f"grid.grids.{scale}.{k}"] = torch.tensor(rng.normal(1, 0.5, (1, channels, full[j], full[i])), dtype=torch.float32)
    layer(rng, w, "feature_out.0", width, 2 * channels)
    layer(rng, w, "feature_out.2", width, width)
    outputs = {"pos_deform": 3, "scales_deform": 3, "rotations_deform": 4, "opacity_deform": 1, "shs_deform": 48, "static_mlp": 1}
    for name, out in outputs.items():
        if name.removesuffix("_deform") in heads or name in more:
            layer(rng, w, f"{name}.1", width, width)
            layer(rng, w, f"{name}.3", out, width, 0.3)
    if "empty_voxel" in more:
        w["empty_voxel.grid"] = torch.tensor(rng.uniform(0, 1, (1, 1, 5, 6, 7)), dtype=torch.float32)
        w["empty_voxel.xyz_min"], w["empty_voxel.xyz_max"] = torch.tensor([-0.8, -0.7, -0.9]), torch.tensor([0.9, 1.0, 0.8])
    named = {f"deformation_net.{key}": value for key, value in w.items()}
    torch.save(named | {"time_poc": torch.zeros(4)}, path.with_name("deformation.pth"))
    flags = ", ".join(f"{name}={name in off}" for name in ("no_dx", "no_ds", "no_dr", "no_do", "no_dshs"))
    (tmp_path / "cfg_args").write_text(f"Namespace(sh_degree=3, {flags}, apply_rotation={'apply_rotation' in more})")
    return model, path, w


def kept(w, h, x):
    """The share of a Gaussian's own values, as their network has it."""
    if "static_mlp.1.weight" in w:
        return lin(w, "static_mlp.3", torch.relu(lin(w, "static_mlp.1", torch.relu(h)))).numpy()
    if "empty_voxel.grid" not in w:
        return np.ones((N, 1))
    low, high = w["empty_voxel.xyz_min"].double(), w["empty_voxel.xyz_max"].double()
    where = ((x.reshape(1, 1, 1, N, 3) - low) / (high - low)).flip((-1,)) * 2 - 1
    return nn.grid_sample(w["empty_voxel.grid"].double(), where, mode="bilinear", align_corners=True).reshape(1, N).T.numpy()


def hamilton(p, q):
    """The product of quaternions, of unit length."""
    (a, b, c, d), (e, f, g, h) = p.T, q.T
    out = np.stack([a * e - b * f - c * g - d * h, a * f + b * e + c * h - d * g, a * g - b * h + c * e + d * f,
                    a * h + b * g - c * f + d * e], 1)
    return out / np.linalg.norm(out, axis=1, keepdims=True)


@pytest.mark.parametrize(("off", "more"), [
    ((), ()), (("no_do", "no_dshs"), ("empty_voxel",)), (("no_dx", "no_dr"), ("static_mlp",)), ((), ("apply_rotation", "static_mlp")),
    ((), ("empty_voxel",))])
def test_hexplane(tmp_path, rng, off, more):
    model, path, w = hexplane(tmp_path, rng, off, more)
    source = fg.open_source(path)
    for t in (0.0, 0.43, 1.0):
        x = torch.tensor(model.position).double()
        high, low = w["grid.aabb"].double()
        place = torch.cat([2 * (x - high) / (low - high) - 1, torch.full((N, 1), t).double()], -1)
        features = []
        for scale in range(2):
            product = 1
            for k, pair in enumerate(((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))):
                where = place[:, list(pair)].reshape(1, 1, N, 2)
                product = product * nn.grid_sample(w[f"grid.grids.{scale}.{k}"].double(), where, align_corners=True, mode="bilinear",
                                                   padding_mode="border")[0, :, 0].T
            features.append(product)
        h = lin(w, "feature_out.2", torch.relu(lin(w, "feature_out.0", torch.cat(features, -1))))

        def head(name, h=h):
            return lin(w, f"{name}_deform.3", torch.relu(lin(w, f"{name}_deform.1", torch.relu(h)))).numpy()

        shown, _ = source.moment(t)
        for flag, name, array in (("no_dx", "pos", "position"), ("no_ds", "scales", "scale"), ("no_dr", "rotations", "rotation"),
                                  ("no_do", "opacity", "opacity"), ("no_dshs", "shs", "features")):
            before = getattr(model, array).reshape(N, -1)
            expected = before if flag in off else before * (1 if name == "rotations" else kept(w, h, x)) + head(name)
            found = getattr(shown, array).reshape(N, -1)
            if name == "rotations" and "apply_rotation" in more:
                expected, found = hamilton(before.astype(float), head(name)), found / np.linalg.norm(found, axis=1, keepdims=True)
            np.testing.assert_allclose(found, expected, atol=1e-4, err_msg=array)


def test_older_networks_without_some_heads(tmp_path, rng):
    """Those of 2023 change neither opacities nor colours."""
    model, path, _ = hexplane(tmp_path, rng, (), (), ("pos", "scales", "rotations"))
    shown, _ = fg.open_source(path).moment(0.4)
    np.testing.assert_array_equal(shown.opacity, model.opacity)
    assert np.abs(shown.position - model.position).max() > 0.01


def test_the_first_stage_stands_still(tmp_path, rng):
    """point_cloud/coarse_iteration_3000 has a network beside it that its stage is drawn without (gaussian_renderer/__init__.py, 75)."""
    model, path, _ = hexplane(tmp_path, rng)
    path.parent.rename(path.parent.with_name("coarse_iteration_9"))
    still = fg.load(path.parent.with_name("coarse_iteration_9") / path.name)
    np.testing.assert_array_equal(still.position, model.position)


def test_baked_into_a_model_and_said_for_what_it_is(tmp_path, rng):
    _, path, _ = hexplane(tmp_path, rng, ("no_do", "no_dshs"))
    with pytest.raises(fg.FastGSError, match="network.*open_source"):
        fg.load(path)
    source = fg.open_source(path)
    source.clip = fg.Clip(20, 30.0)
    source.at = np.arange(20.0)
    source._read = lambda i: source._compute(i / 20)
    with pytest.warns(fg.LossWarning, match="RMS error"):
        model = one_model(source)
    a, b = fg.slice_model(model, 0.5, cull=False), fg.slice_model(source.moment(0.5)[0], 0, cull=False)
    assert np.median(np.linalg.norm(a.position - b.position, axis=1)) < 0.02


def test_numbers_that_many_weights_share_are_not_multiplied(tmp_path, rng):
    """A pickle may name the same megabyte a thousand times."""
    _, path, w = hexplane(tmp_path, rng)
    large = torch.zeros(1 << 18)
    torch.save({f"deformation_net.{key}": value for key, value in w.items()} | {f"more.{i}": large for i in range(1000)},
               path.with_name("deformation.pth"))
    with pytest.raises(fg.FastGSError, match="far larger"):
        fg.open_source(path)


@pytest.mark.slow
def test_mutated_weights(tmp_path, rng):
    _, path, _ = hexplane(tmp_path / "made", rng)
    files = {"point_cloud.ply": path.read_bytes(), "deformation.pth": path.with_name("deformation.pth").read_bytes()}
    (tmp_path / "seeds").mkdir()
    read = mutations.shows("point_cloud.ply")
    told = mutations.campaign("hexplane", read, {"small": files}, tmp_path / "seeds", fixed=["point_cloud.ply"])
    assert min(told.values(), default=1) > 0
