# SPDX-License-Identifier: GPL-3.0-or-later
"""Edges of meshes before splats before meshes, in random arrangements, beside pictures of the three that are laid over each other."""
import numpy as np
import pytest


def over(front, back):
    """Premultiplied pictures [h, w, 4], one over the other."""
    return front + (1 - front[..., 3:]) * back


@pytest.fixture
def arranged(scene, screen, wall, shine, add, add_camera):
    """arranged(rng, blurred): a few meshes before the screen of splats, which move while the shutter is open if blurred, and behind it."""
    def make(rng, blurred):
        add_camera(lens=30.0)
        scene.render.film_transparent, scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, blurred, 1.0
        front, back = [], []
        for kind in ("wall", "ball", "ring")[:rng.integers(1, 4)]:
            x, z, size, colour = rng.uniform(-1, 1), rng.uniform(-0.8, 0.8), rng.uniform(0.3, 1.5), rng.uniform(0, 1, 3)
            if kind == "wall":
                obj = wall(x, -1.0, colour, size=size)
                obj.rotation_euler.y = rng.uniform(0, 3)
            elif kind == "ball":
                obj = shine(add("uv_sphere", radius=size / 2, location=(x, -1, 0)), colour)
            else:
                ring = add("torus", major_radius=size / 2, minor_radius=size / 8, rotation=(np.pi / 2, 0, 0), location=(x, -1, 0))
                obj = shine(ring, colour)
            front.append(obj)
            for frame, way in ((0, -0.3), (2, 0.3)):
                obj.location.x, obj.location.z = x + blurred * way, z
                obj.keyframe_insert("location", frame=frame)
        for _ in range(rng.integers(1, 4)):
            back.append(wall(rng.uniform(-2, 2), rng.uniform(1, 2), rng.uniform(0, 1, 3), size=rng.uniform(0.8, 4)))
            back[-1].rotation_euler.y, back[-1].location.z = rng.uniform(0, 3), rng.uniform(-1, 1)
        if rng.random() < 0.5:
            screen.scale = rng.uniform(0.2, 1), 1, rng.uniform(0.2, 1)
        scene.frame_set(1)
        return front, back

    return make


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "blurred"), [(0, False), (1, False), (2, False), (3, True)])
def test_hidden_meshes_do_not_leak(scene, screen, sky, arranged, choose, render, seed, blurred):
    """No pixel is far from the three pictures over each other, and few are off by more than noise and pixel filters."""
    front, back = arranged(np.random.default_rng(seed), blurred)

    def alone(engine, *objects):
        scene.render.engine = engine
        for obj in (screen, *front, *back):
            obj.hide_render = obj not in objects
        return next(image for name, image in render().items() if name.endswith("Combined"))

    scene.cycles.samples, scene.cycles.use_denoising = 64, False
    layers = alone('CYCLES', *front), alone('FASTGS', screen), alone('CYCLES', *back)
    wanted = over(layers[0], over(layers[1], layers[2]))
    scene.render.engine = 'FASTGS'
    for obj in (screen, *front, *back):
        obj.hide_render = False
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0, 0, 0, 1)
    scene.render.film_transparent = False  # PNG files hold straight colours, which a black world leaves as they are
    choose().cycles.samples = 64
    found = np.abs(render("PNG16")[..., :3] - np.clip(wanted[..., :3], 0, 1)).max(-1)
    edges = ((layers[0][..., 3] > 0.01) & (layers[0][..., 3] < 0.99)).sum()
    assert found.max() < 0.35 and (found > 0.1).sum() < 0.25 * edges
