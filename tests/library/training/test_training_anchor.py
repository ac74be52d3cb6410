# SPDX-License-Identifier: GPL-3.0-or-later
"""The pull on backdrop colours: Gaussians that pictures hardly show keep their colours, others take those of the pictures."""
import numpy as np
from toy_captures import Pixels, toy_capture

import fastgs_blender as fg
from fastgs_blender.captures.capture import Points
from fastgs_blender.training.core import anchor, settings
from fastgs_blender.training.core.start import Start
from fastgs_blender.training.core.trainer import Trainer
from fastgs_blender.training.initial.first_model import model_from_points
from fastgs_blender.training.run import intermediate
from fastgs_blender.util.backends import load_backend

FRINGE = 40


def test_the_pull_is_as_strong_as_so_many_pixels():
    features = np.array([[0.5, 0.5], [0.5, 0.5], [0.5, 0.5]], np.float32)
    arrays = {"features": features + np.float32(anchor.OFF), anchor.ANCHOR: anchor.anchor_features(features, np.array([1.0, np.nan, 1.0]))}
    gradients = {"features": np.ones((3, 2), np.float32)}
    anchor.anchor(load_backend("cpu"), arrays, gradients, np.array([0, 1]), pixels=1000)
    np.testing.assert_allclose(gradients["features"], [[1 + anchor.PIXELS / 3000] * 2, [1, 1], [1, 1]], rtol=1e-6)


def trained(capture, store, points, **choices):
    """The trainer after 200 steps without density control."""
    rates = dict(position_rate=1.6e-4, scale_rate=5e-3, rate_decay=1.0)  # colours can go as far as they do here
    chosen = settings.settings(iterations=200, densify_from=1.0, warm_up=(), preview_every=0, **rates, **choices)
    first = model_from_points(points, chosen, capture.clip, capture.axes, capture.extent)
    trainer = Trainer(capture, store, chosen, Start(first, points.size))
    for _ in range(200):
        trainer.step()
    return trainer


def beside():
    """How far the colours of large Gaussians went that stand beside the pictures, which show a fringe of them."""
    capture, store, points = toy_capture()
    around = np.linspace(0, 2 * np.pi, FRINGE, endpoint=False)
    xyz = np.stack([7.5 * np.cos(around), 7.5 * np.sin(around), np.full(FRINGE, 5.0)], 1)
    sizes = np.concatenate([np.full(len(points), np.nan), np.full(FRINGE, 1.0)])
    rgb = np.concatenate([points.rgb, np.full((FRINGE, 3), 0.5)])
    points = Points(np.concatenate([points.xyz, xyz]).astype(np.float32), rgb, None, sizes)
    after = trained(capture, store, points).model()
    return np.abs(after.features[-FRINGE:, :3] - 0.5).max()


def test_colours_that_hardly_anything_speaks_for_stay(monkeypatch):
    assert beside() < 0.15
    monkeypatch.setattr(anchor, "PIXELS", 0.0)
    assert beside() > 0.5


def test_what_pictures_show_takes_their_colours(monkeypatch):
    """A wall that fills all pictures, and was taken for another colour."""
    capture, store, _ = toy_capture()
    for key, pixels in store.pictures.items():
        store.pictures[key] = Pixels(np.full_like(pixels.rgb, 0.6))
    grid = np.stack(np.meshgrid(np.linspace(-6, 6, 9), np.linspace(-5, 5, 7)), -1).reshape(-1, 2)
    xyz = np.concatenate([grid, np.full((len(grid), 1), 3.0)], 1).astype(np.float32)
    points = Points(xyz, np.full((len(xyz), 3), 0.3), None, np.full(len(xyz), 1.2))
    monkeypatch.setattr(anchor, "PIXELS", 5.0)
    trainer = trained(capture, store, points, appearance="rgb")  # a decoder could take their part
    shot = capture.held_out[0]
    picture = fg.render(trainer.model(), shot.camera, shot.t)["rgb"]
    assert np.abs(picture - 0.6).mean() < 0.03


def test_a_trained_model_knows_its_backdrop_and_cameras():
    """The far ring is the backdrop, though training moves it, and density control copies it; files of unfinished runs know it too."""
    capture, store, points = toy_capture()
    around = np.linspace(0, 2 * np.pi, FRINGE, endpoint=False)
    far = 40.0
    xyz = capture.focus + np.stack([far * np.cos(around), far * np.sin(around), np.zeros(FRINGE)], 1)
    sizes = np.concatenate([np.full(len(points), np.nan), np.full(FRINGE, 1.0)])
    rgb = np.concatenate([points.rgb, np.full((FRINGE, 3), 0.5)])
    points = Points(np.concatenate([points.xyz, xyz]).astype(np.float32), rgb, None, sizes)
    chosen = settings.settings(iterations=30, densify_from=0.0, densify_every=5, warm_up=(), preview_every=0)
    first = model_from_points(points, chosen, capture.clip, capture.axes, capture.extent)
    trainer = Trainer(capture, store, chosen, Start(first, points.size))
    for _ in range(30):
        trainer.step()
    model = trainer.final_model({})
    backdrop, cameras = model.surroundings.backdrop, model.surroundings.cameras
    assert np.allclose(backdrop.centre, capture.focus) and 0.8 * far < backdrop.radius < far
    assert (backdrop.distance(model.position) > 1).sum() >= FRINGE
    assert [camera.name for camera in cameras] == [view for view in capture.views if view not in capture.held_out_views]
    assert np.allclose(sorted(camera.position for camera in cameras), sorted(capture.centres().tolist()), atol=1e-6)
    assert intermediate.model_of(*trainer.state()).surroundings.backdrop == backdrop
    arrays = trainer.optimiser.arrays
    arrays["position"][np.flatnonzero(np.isfinite(arrays[anchor.ANCHOR][:, 0]))[0]] = capture.focus  # one of them astray
    least = anchor.INNERMOST * np.linalg.norm(capture.centres() - capture.focus, axis=1).max()
    assert np.isclose(trainer.final_model({}).surroundings.backdrop.radius, least)


def test_density_control_leaves_the_backdrop_whole():
    """Its Gaussians fill the sky together: where one went, those beside it would grow until they were removed too."""
    capture, store, points = toy_capture()
    chosen = settings.settings(prune_size=0.2, prune_opacity=0.0, densify_share=0)
    around = np.linspace(0, 2 * np.pi, FRINGE, endpoint=False)
    xyz = np.concatenate([points.xyz, np.stack([9 * np.cos(around), 9 * np.sin(around), np.full(FRINGE, 5.0)], 1)]).astype(np.float32)
    sizes = np.concatenate([np.full(len(points), np.nan), np.full(FRINGE, 50.0)])
    points = Points(xyz, np.concatenate([points.rgb, np.full((FRINGE, 3), 0.5)]), None, sizes)
    first = model_from_points(points, chosen, capture.clip, capture.axes, capture.extent)
    trainer = Trainer(capture, store, chosen, Start(first, points.size))
    trainer.optimiser.arrays["scale"][0] = np.log(50.0)  # fog
    with trainer.optimiser.on_host() as rows:
        trainer.strategy.after_step(trainer.strategy.first // 100 * 100 + 100, rows, trainer.statistics.on_host(trainer.backend), {})
    arrays = trainer.optimiser.arrays
    assert np.isfinite(arrays[anchor.ANCHOR]).all(1).sum() == FRINGE
    assert len(trainer) == len(points) - 1
    assert np.exp(arrays["scale"].max()) <= capture.extent
