# SPDX-License-Identifier: GPL-3.0-or-later
"""Work that a viewport avoids: drawing the same splats again, reading depth, waiting for an order."""
from __future__ import annotations

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from gpu_context import draw_offscreen, open_gpu
from held_runs import until

SIZE = 96, 64


@pytest.fixture
def parts(module):
    """The modules of the viewport that these tests use."""
    return SimpleNamespace(**{name: module(f"engine.viewport.{name}") for name in (
        "atlas", "eye", "picture", "shaders", "spaces", "view", "worker")})


@pytest.fixture
def view(parts, scene):
    open_gpu(scene)
    worker = parts.worker.Worker()
    view = parts.view.View(parts.atlas.Atlas(), worker)
    yield view
    view.free()
    worker.stop()


@pytest.fixture
def still(parts, monkeypatch):
    """still(): time passes until a view rests."""
    now = [100.0]
    monkeypatch.setattr(parts.view, "time", SimpleNamespace(monotonic=lambda: now[0]))

    def wait():
        now[0] += 2 * parts.view.RESTING

    wait.now = now
    return wait


@pytest.fixture
def drawn(parts, monkeypatch):
    """How often splats were blended: a list that grows."""
    found, splats = [], parts.shaders.splats

    def counted(*kind):
        found.append(kind)
        return splats(*kind)

    monkeypatch.setattr(parts.shaders, "splats", counted)
    return found


@pytest.fixture
def window(module, parts, view):
    """window(paths, turn=0, at=0, wall=None, **options) -> picture: draw the files over a wall at a distance from the camera.

    depth=True hands over the window's depth, as a viewport does that shows surfaces; it is `window.read` that counts the readings.
    """
    files, retime = module("scene.snapshot"), module("scene.time").Retime(start_frame=0.0)
    matrix = np.array([[1.2, 0, 0.1, 0], [0, 1.8, -0.05, 0], [0, 0, -1.002, -0.2], [0, 0, -1, 0]])
    read = []

    def draw(paths, turn=0.0, at=0.0, wall=None, state=0, surfaces=True, over=True, wait=True, after=None, **options):
        pose = np.array([[np.cos(turn), 0, np.sin(turn), 0], [0, 1, 0, 0], [-np.sin(turn), 0, np.cos(turn), -4], [0, 0, 0, 1.0]])
        camera, depths = parts.eye.eye(*SIZE, pose, matrix)
        shown = files.Snapshot([files.FileInstance(path, path, np.eye(4), retime) for path in paths], at, 30.0)

        def reading():
            read.append(turn)
            return parts.spaces.scene_depth(*SIZE, depths)

        around = parts.view.Around(depths, (state,), surfaces, reading) if over else None

        def paint(framebuffer):
            if wall is not None:
                framebuffer.clear(depth=depths.a + depths.b / wall)
            view.draw(shown, camera, parts.view.Display(np.eye(3)), around=around, wait=wait, **options)
            if after:
                after(framebuffer, depths)

        return draw_offscreen(*SIZE, paint)

    draw.read = read
    return draw


@pytest.fixture
def two(fg, model_file):
    """Two files: a screen of opaque Gaussians two units before the origin on the left, and one two units behind it, everywhere."""
    def screen(z, colour, left, name):
        y, x = (a.ravel() for a in np.meshgrid(np.linspace(-4, 4, 60), np.linspace(-5, 0 if left else 5, 80)))
        n = len(x)
        return model_file(fg.GaussianModel(
            position=np.stack([x, y, np.full(n, z)], 1), rotation=np.tile([1.0, 0, 0, 0], (n, 1)), scale=np.full((n, 3), -1.6),
            opacity=np.full(n, 6.0), features=np.tile(np.asarray(colour, float), (n, 1))), name)

    return screen(2.0, (0.9, 0.1, 0.1), True, "near.safetensors"), screen(-2.0, (0.1, 0.1, 0.9), False, "far.safetensors")


LEFT, RIGHT = (slice(8, -8), slice(8, 36)), (slice(8, -8), slice(64, -8))


@pytest.mark.parametrize("surfaces", [True, False])
def test_a_wall_between_hides_what_is_behind_it(window, two, still, surfaces):
    """Tested splat by splat from the depth that was read, and by the GPU for the whole picture."""
    free = window(two, surfaces=surfaces)
    assert free[LEFT][..., 0].min() > 0.5 and free[RIGHT][..., 2].min() > 0.5
    got = window(two, wall=4.0, state=1, surfaces=surfaces)
    still()
    for image in (got, window(two, wall=4.0, state=1, surfaces=surfaces)):
        np.testing.assert_allclose(image[LEFT], free[LEFT], atol=1e-3)
        assert not image[RIGHT].any()
    assert not window(two, wall=1.0, state=2, surfaces=surfaces).any()
    assert len(window.read) == (2 if surfaces else 0)


def test_a_still_picture_costs_nothing(parts, window, two, drawn, still, monkeypatch):
    """Nothing is blended, no colour is computed, no depth is read: the finished picture is put into the window."""
    first = window(two, wall=4.0)
    assert len(drawn) == len(window.read) == 1
    monkeypatch.setattr(parts.shaders, "resolve", lambda *kind: pytest.fail("colours are computed again"))
    for _ in range(5):
        np.testing.assert_array_equal(window(two, wall=4.0), first)
    assert len(drawn) == len(window.read) == 1


def test_diagnostics_time_each_stage(module, parts, window, two, view, monkeypatch):
    assert view.timed() is None
    window(two, over=False)
    camera, count, stages = view.timed()
    assert (camera.width, camera.height) == SIZE and count > 1000
    assert tuple(stages) == module("engine.viewport.timing").STAGES and all(0 < value < 60_000 for value in stages.values())
    monkeypatch.setitem(parts.spaces.viewports.views, (1, True), view)
    text = module("engine.diagnostics").text()
    assert "viewport of 96 x 64 with" in text and "blending splats" in text and "the depth back" in text


def test_nothing_is_read_while_the_view_moves(window, two, drawn, still, view):
    window(two, wall=4.0)
    before = len(window.read)
    for number in range(1, 5):
        window(two, turn=0.02 * number, wall=4.0)
        window(two, turn=0.02 * number, at=number / 10, wall=4.0)
        assert view.coarse, "a better picture is still to come"
    assert len(window.read) == before
    still()
    window(two, turn=0.08, at=0.4, wall=4.0)
    assert len(window.read) == before + 1 and not view.coarse


def test_nothing_is_ever_read_where_only_splats_are(window, two, still, view):
    for number in range(3):
        window(two, turn=0.1 * number, surfaces=False)
        assert not view.coarse
        still()
        window(two, turn=0.1 * number, surfaces=False)
    assert not window.read


def test_redraws_of_one_moment_blend_once(window, two, drawn, still):
    """A moving mesh hides other splats; while it moves the GPU's depth test finds which, and nothing is blended again."""
    window(two, wall=4.0)
    window(two, wall=4.0, state=1)
    count = len(drawn)
    for number in range(2, 6):
        image = window(two, wall=4.0 if number % 2 else 1.0, state=number)
        assert image[LEFT].any() == bool(number % 2)
    assert len(drawn) == count


def test_scrubbing_draws_fewer_splats(window, two, still, view):
    whole = window(two), view._order[1].count
    window(two, at=1.0, density=0.25)
    assert view.coarse and view._order[1].count < 0.3 * whole[1]
    still()
    np.testing.assert_array_equal(window(two, at=1.0, density=0.25), whole[0])


@pytest.mark.parametrize("surfaces", [False, True])
def test_a_still_picture_fades_in(parts, window, two, still, view, drawn, surfaces):
    """From the picture of the moving view to that of the still one in steps of a few percent, and nothing is blended for them.

    In many pixels only one of the two lies before the wall.
    """
    whole = window(two, at=1.0, wall=4.0, surfaces=surfaces)
    options = dict(at=1.0, density=0.02, wall=4.0, state=1, surfaces=surfaces)
    window(two, **options)
    coarse = window(two, **options)
    assert np.abs(coarse - whole).mean() > 0.01
    still()
    window(two, wait=False, **options)  # asks for the rest
    until(lambda: view.stale)
    shown = [coarse, window(two, wait=False, **options)]
    np.testing.assert_allclose(shown[1], coarse, atol=2e-3)
    count = len(drawn)
    while view.coarse and len(shown) < 50:
        still.now[0] += parts.view.FADE / 10
        shown.append(window(two, wait=False, **options))
    assert 10 <= len(shown) <= 14 and len(drawn) == count
    np.testing.assert_allclose(shown[-1], whole, atol=2e-3)
    for before, after in itertools.pairwise(shown):
        assert (np.abs(after - before) <= 0.15 * np.abs(whole - coarse) + 0.01).all()


def test_what_was_deleted_goes_at_once(window, two, view):
    """Before the thread has sorted what is left; what has moved meanwhile is where it is now."""
    both, alone = window(two, over=False), window(two[1:], over=False)
    window(two, over=False)
    assert np.abs(both - alone).max() > 0.5
    np.testing.assert_allclose(window(two[1:], over=False, wait=False), alone, atol=1e-3)
    until(lambda: not view.waiting)
    assert not window([], over=False, wait=False).any()


def white_line(left, right, depth):
    """Draw columns of pixels with their depth."""
    import gpu
    from gpu_extras.batch import batch_for_shader
    from mathutils import Matrix

    shader = gpu.shader.from_builtin('UNIFORM_COLOR')
    a, b = (2 * x / SIZE[0] - 1 for x in (left, right))
    corners = [(x, y, 2 * depth - 1) for x, y in ((a, -1), (b, -1), (b, 1), (a, -1), (b, 1), (a, 1))]
    with gpu.matrix.push_pop(), gpu.matrix.push_pop_projection():
        gpu.matrix.load_identity()
        gpu.matrix.load_projection_matrix(Matrix.Identity(4))
        gpu.state.depth_test_set('ALWAYS')
        gpu.state.depth_mask_set(True)
        shader.uniform_float("color", (1, 1, 1, 1))
        batch_for_shader(shader, 'TRIS', {"pos": corners}).draw(shader)
        gpu.state.depth_mask_set(False)
        gpu.state.depth_test_set('NONE')


def test_overlays_behind_splats_are_taken_away(window, two, view):
    """White overlays everywhere, one line of them before the splats, and a mark; the grid of a floor that lies far below."""

    def after(framebuffer, depths):
        framebuffer.clear(color=(1.0, 1.0, 1.0, 1.0))
        framebuffer.clear(depth=1.0)
        white_line(10, 14, depths.a + depths.b / 1.5)
        view.cover(depths, SIZE, False, [(30.0, 30.0, 6.0)])

    image = window(two[:1], over=False, deep=True, after=after)
    assert (image[:, 10:14] == 1).all(), "a line before the splats stays"
    assert (image[-30 - 3:-30 + 3, 28:32] == 1).all(), "so does what is drawn over everything"
    assert image[8:-40, 16:36].max() < 0.02
    assert (image[:, 70:] == 1).all()


@pytest.mark.parametrize("floor", [True, False])
def test_the_grid_stays_where_the_floor_is_nearer(window, two, view, floor):
    """The camera looks straight down from a height of 4: the floor lies behind the near screen and before the far one."""
    def after(framebuffer, depths):
        framebuffer.clear(color=(1.0, 1.0, 1.0, 1.0), depth=1.0)
        view.cover(depths, SIZE, floor, [])

    image = window(two, over=False, deep=True, after=after)
    assert image[LEFT].max() < 0.02
    assert (image[RIGHT] == 1).all() if floor else image[RIGHT].max() < 0.02
