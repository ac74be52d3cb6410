# SPDX-License-Identifier: GPL-3.0-or-later
"""*Render With Meshes* in a shot that has everything at once."""
import bpy
import image_files
import numpy as np
import pytest
from joined import column, tree_of


@pytest.mark.slow
def test_layers_eyes_cuts_flags_and_instances_in_one_animation(scene, screen, wall, add_camera, choose, compositor, tmp_path):
    """Three view layers, two eyes, a cut to a second camera, a holdout, and instances of a mesh and of splats: in each file, by pixels."""
    cameras = [add_camera(location=(x, -5, 0), lens=30.0) for x in (0.0, 1.0)]
    for camera in cameras:
        camera.data.stereo.convergence_distance, camera.data.stereo.interocular_distance = 5.0, 1.0
    scene.render.film_transparent, near = True, bpy.data.collections.new("Near")
    scene.collection.children.link(near)
    for obj, name, x in ((wall(0, 0, (0, 0, 1)), "Blue", 1.5), (screen, "Splats", 0)):
        inside = bpy.data.collections.new(name)
        inside.objects.link(obj)
        scene.collection.objects.unlink(obj)
        maker = bpy.data.objects.new(f"{name} Instance", None)
        maker.instance_type, maker.instance_collection, maker.location = 'COLLECTION', inside, (x, -1.0 * (x > 0), 0)
        scene.collection.objects.link(maker)
    green = wall(-1.5, -1.0, (0, 1, 0))
    near.objects.link(green)
    scene.collection.objects.unlink(green)
    compositor.show("Image")
    choose()
    scene.view_layers.new("Second").layer_collection.children["Near"].exclude = True
    scene.view_layers.new("Third").layer_collection.children["Near"].holdout = True
    tree = tree_of(scene)
    for name in ("Second", "Third"):
        layers = tree.nodes.new('CompositorNodeRLayers')
        layers.scene, layers.layer = scene, name
        tree.links.new(layers.outputs["Image"], tree.nodes.new('CompositorNodeBlur').inputs["Image"])
    for frame, camera in enumerate(cameras, 1):
        scene.timeline_markers.new(camera.name, frame=frame).camera = camera
    scene.render.use_multiview = scene.fastgs.write_passes = True
    scene.frame_start, scene.frame_end = 1, 2
    image_files.set_output(scene, "PNG16")
    scene.render.filepath = str(tmp_path / "shot_")
    bpy.ops.render.render(animation=True)
    edges = {}
    for frame, away in ((1, 0.0), (2, 1.0)):
        for eye in "LR":
            path, = tmp_path.glob(f"*passes_*{frame:04}*{eye}.exr")
            planes = image_files.read_exr(path)
            for layer, wanted in (("ViewLayer", (0, 1, 0, 1)), ("Second", None), ("Third", (0, 0, 0, 0))):
                found = [image for name, image in planes.items() if name.startswith(f"{layer} Join") and name.endswith("Combined")]
                assert len(found) == 1, list(planes)
                picture = found[0]
                row = picture[24]
                at = row[column(-1.5 - away, -1)] if away == 0 else row[0]
                np.testing.assert_allclose(row[column(1.5 - away, -1)], (0, 0, 1, 1), atol=0.02, err_msg=f"{path.name}: {layer}")
                assert row[column(0.3 - away), 0] > 0.7 * row[column(0.3 - away), 3] > 0.5, "instanced splats"
                if wanted is None:
                    assert at[0] > 0.5 and at[1] < 0.2
                else:
                    np.testing.assert_allclose(at, wanted, atol=0.02, err_msg=f"{path.name}: {layer}")
                edges[frame, eye] = int(np.flatnonzero(row[:, 2] > 0.5)[0])
    assert edges[1, "L"] != edges[1, "R"] and edges[2, "L"] < edges[1, "L"] and edges[2, "R"] < edges[1, "R"]
