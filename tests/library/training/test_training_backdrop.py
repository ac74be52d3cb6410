# SPDX-License-Identifier: GPL-3.0-or-later
"""The starting points far behind a scene: they lie where pictures show nothing else, in the colours of the background."""
import numpy as np
import pytest
from toy_captures import Pixels, toy_capture

from fastgs_blender.training.core import settings
from fastgs_blender.training.core.camera_response import CameraResponse, CorrectedStore
from fastgs_blender.training.initial import backdrop
from fastgs_blender.training.initial.geometry import project, visible

SKY, BALL = 0.6, (0.9, 0.1, 0.1)


@pytest.fixture
def filmed():
    """(capture, store, points): a grey sky, before which a red ball flies across all pictures' upper parts."""
    capture, store, points = toy_capture()
    for (view, frame), pixels in store.pictures.items():
        image = np.full_like(pixels.rgb, SKY)
        image[2:9, 8 * frame:8 * frame + 8] = BALL
        store.pictures[view, frame] = Pixels(image)
    return capture, store, points.take(np.s_[:0])


def behind(filmed):
    capture, store, points = filmed
    return backdrop.with_backdrop(capture, store, settings.settings(init_points=1000, backdrop=0.5), points)


def test_what_passes_by_is_not_the_sky(filmed):
    points = behind(filmed)
    assert len(points) > 20
    assert np.allclose(points.rgb, SKY, atol=0.02)
    assert np.isnan(points.t).all() and np.isfinite(points.size).all()


def test_it_stands_behind_everything_that_cameras_see(filmed):
    capture = filmed[0]
    points = behind(filmed)
    apart = np.linalg.norm(points.xyz - capture.focus, axis=1)
    assert np.ptp(apart) < 1e-3 * apart.mean()
    assert apart.min() > 2 * np.linalg.norm(capture.centres() - capture.focus, axis=1).max()
    for shot in capture.at_frame(0):
        seen = visible(shot.camera, points.xyz)
        places = project(shot.camera, points.xyz[seen])[0]
        reach = 2.5 * points.size[0] / apart[0] * shot.camera.fx
        for corner in np.array([[0.1, 0.1], [0.9, 0.1], [0.1, 0.9], [0.9, 0.9]]) * (shot.camera.width, shot.camera.height):
            assert np.linalg.norm(places - corner, axis=1).min() < reach


def test_cameras_that_differ_agree_on_it(filmed):
    """One camera is overexposed, one dark: the sky has the colour in which their evened pictures agree, from those that show it."""
    capture, store, points = filmed
    views = tuple(dict.fromkeys(shot.view for shot in capture.training))
    gains = np.ones((len(views), 3))
    gains[0], gains[1] = 2.0, 0.5
    for (view, frame), pixels in store.pictures.items():
        gain = gains[views.index(view)] if view in views else np.ones(3)
        store.pictures[view, frame] = Pixels(np.float32(np.clip(pixels.rgb * gain, 0, 1)))
    told = np.stack([np.log(gains), np.full_like(gains, 0.01)], 1)
    even = CameraResponse.initial(views, capture.clip.frame_count, settings.settings(), told)
    found = backdrop.with_backdrop(capture, CorrectedStore(store, even), settings.settings(init_points=1000, backdrop=0.5), points)
    assert len(found) > 20 and np.allclose(found.rgb, SKY, atol=0.02)


def test_cut_pictures_have_none(filmed):
    capture, store, points = filmed
    for key, pixels in store.pictures.items():
        store.pictures[key] = Pixels(pixels.rgb, mask=np.ones(pixels.rgb.shape[:2]))
    chosen = settings.settings(init_points=1000, masks="cut")
    assert len(backdrop.with_backdrop(capture, store, chosen, points)) == 0
