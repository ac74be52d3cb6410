# SPDX-License-Identifier: GPL-3.0-or-later
"""Panoramic cameras look where Cycles' do."""
import bpy
import numpy as np
import pytest


@pytest.mark.parametrize("kind", ['EQUIRECTANGULAR', 'FISHEYE_EQUIDISTANT', 'FISHEYE_EQUISOLID'])
def test_directions_are_those_of_cycles(scene, add, add_camera, cameras, render, kind, splat_object, model_file, make_model):
    """From inside a sphere Cycles' Position pass says where each pixel looks."""
    camera = add_camera((0, 0, 0), (70, 20, 30), type='PANO')
    kinds = camera.data if hasattr(camera.data, "panorama_type") else camera.data.cycles
    kinds.panorama_type = kind
    kinds.fisheye_fov, kinds.longitude_min, kinds.latitude_max = 2.6, -2.0, 1.2
    splat_object(model_file(make_model(200, spread=3.0)))
    scene.view_layers[0].fastgs.use_pass_alpha = True
    assert render()["ViewLayer.Splat Alpha"].max() > 0.5
    add("uv_sphere", segments=64, ring_count=32, radius=50)
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = 'CYCLES', 16, False
    scene.view_layers[0].use_pass_position = True
    place = render()["ViewLayer.Position"]
    depsgraph = bpy.context.evaluated_depsgraph_get()
    ours = cameras.panorama_of(camera.evaluated_get(depsgraph), cameras.render_area(scene.render))
    seen = ours.directions() @ np.linalg.inv(ours.world_to_camera)[:3, :3].T
    length = np.linalg.norm(place, axis=-1)
    both = (length > 40) & ~np.isnan(seen[..., 0])
    assert both.mean() > 0.25 and (both == (length > 40)).mean() > 0.95
    assert np.abs(place[both] / length[both][:, None] - seen[both]).mean() < 0.02
