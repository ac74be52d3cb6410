# SPDX-License-Identifier: GPL-3.0-or-later
"""The conversion from scene frames to capture frames."""
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

MODES = ('HIDE', 'HOLD', 'LOOP', 'PING_PONG')
ROUNDING = 0.01
"""Frames so far from the start (1e4) are exact to 1e-6 of that."""
counts = st.integers(1, 500)
frames = st.floats(-2000, 2000)
rates = st.sampled_from((12.0, 24.0, 25.0, 30.0, 30000 / 1001, 60.0))


@pytest.fixture(scope="module")
def show(module, fg):
    """show(frame, n=10, fps=24, clip_fps=24, **retime): the clip's frame."""
    time = module("scene.time")

    def call(frame, n=10, fps=24.0, clip_fps=24.0, **retime):
        return time.clip_frame(frame, fps, time.Retime(**retime), fg.Clip(n, clip_fps))

    return call


@pytest.mark.parametrize(("frame", "retime", "expected"), [
    (1, {}, 0), (4, {}, 3), (4.25, {}, 3.25), (10, {}, 9),
    (7, dict(start_frame=5), 2), (7, dict(start_frame=5.5), 1.5),
    (5, dict(speed=2), 8), (5, dict(speed=0.5), 2), (3, dict(offset=4.5), 6.5),
    (1, dict(speed=-1), 9), (3.5, dict(speed=-1), 6.5), (3, dict(speed=-2, offset=-1), 4), (77, dict(speed=0, offset=3), 3),
    (0, dict(before='HOLD'), 0), (99, dict(after='HOLD'), 9),
    (0.9, dict(before='HIDE'), None), (10.9, dict(after='HIDE'), 9.9), (11, dict(after='HIDE'), None),
    (11, dict(after='LOOP'), 0), (10.5, dict(after='LOOP'), 9.5), (33.25, dict(after='LOOP'), 2.25), (0, dict(before='LOOP'), 9),
    (11, dict(after='PING_PONG'), 8), (19, dict(after='PING_PONG'), 0), (20, dict(after='PING_PONG'), 1),
    (0, dict(before='PING_PONG'), 1), (-9, dict(before='PING_PONG'), 8),
    (12, dict(speed=-1, before='LOOP', after='HIDE'), 8), (0, dict(speed=-1, before='LOOP', after='HIDE'), None),
])
def test_by_hand(show, frame, retime, expected):
    actual = show(frame, **retime)
    assert actual is expected if expected is None else actual == pytest.approx(expected, abs=1e-9)


def test_seconds_count_and_not_frames(show):
    """Ten frames after the start at 24 fps are 12.5 frames of a capture at 30."""
    assert show(11, n=100, clip_fps=30) == pytest.approx(12.5)
    assert show(11, n=100, fps=30000 / 1001, clip_fps=30) == pytest.approx(10.01)


@given(counts, rates, rates, frames, st.floats(-4, 4), st.floats(-50, 50), st.sampled_from(MODES), st.sampled_from(MODES))
def test_stays_in_the_clip(show, n, fps, clip_fps, frame, speed, offset, before, after):
    f = show(frame, n, fps, clip_fps, speed=speed, offset=offset, before=before, after=after)
    assert f is None or 0 <= f < n
    assert f is not None or 'HIDE' in (before, after)


@given(counts, frames, st.floats(-4, 4), st.floats(0, 1e-3))
def test_hold_and_ping_pong_are_continuous(show, n, frame, speed, step):
    for mode in ('HOLD', 'PING_PONG'):
        a, b = (show(f, n, speed=speed, before=mode, after=mode) for f in (frame, frame + step))
        assert abs(b - a) <= abs(speed) * step + ROUNDING


@given(counts, frames, st.integers(-3, 3))
def test_loop_repeats(show, n, frame, rounds):
    a, b = (show(f, n, before='LOOP', after='LOOP') for f in (frame, frame + rounds * n))
    assert min(abs(a - b), n - abs(a - b)) < ROUNDING


@given(st.integers(2, 500), frames)
def test_ping_pong_is_symmetric(show, n, frame):
    modes = dict(before='PING_PONG', after='PING_PONG')
    assert show(1 + frame, n, **modes) == pytest.approx(show(1 - frame, n, **modes), abs=ROUNDING)


@given(st.integers(2, 500), st.floats(0, 1), st.floats(0.01, 4))
def test_backwards_mirrors_forwards(show, n, where, speed):
    frame = 1 + where * (n - 1) / speed
    assert show(frame, n, speed=-speed) == pytest.approx(n - 1 - show(frame, n, speed=speed), abs=ROUNDING)


@given(counts, st.floats(0.01, 4), st.integers(1, 400), st.sampled_from(MODES))
def test_single_precision_settings_do_not_step_over_a_boundary(show, n, speed, rounds, mode):
    """Blender stores 0.7 as 0.69999998: after a whole number of rounds a loop shows frame 0, not the last instant before it."""
    speed = float(np.float32(speed))
    first = show(1 + 1e-7, n, speed=speed, before=mode, after=mode)
    assert first is not None and first < 1e-5
    start = 1 + rounds * n / speed
    looped = show(start * (1 - 1e-9), n, speed=speed, after='LOOP')
    assert looped < 1e-3


@given(frames, st.sampled_from(('HOLD', 'LOOP', 'PING_PONG')))
def test_one_frame(show, frame, mode):
    f = show(frame, 1, before=mode, after=mode)
    assert 0 <= f < 1 and (mode == 'LOOP' or f == 0)


@pytest.fixture(scope="module")
def show_all(module, fg):
    """show_all(frame, n=10, **retime): the clip's frames with their opacities, rounded."""
    time = module("scene.time")

    def call(frame, n=10, **retime):
        return [(round(f, 6), round(share, 6)) for f, share in time.shown_frames(frame, 24.0, time.Retime(**retime), fg.Clip(n, 24.0))]

    return call


@pytest.mark.parametrize(("frame", "retime", "expected"), [
    # trimmed: the clip is what is left
    (1, dict(trim_start=2), [(2, 1)]), (99, dict(trim_start=2, trim_end=3), [(6, 1)]),
    (1, dict(trim_start=2, trim_end=3, speed=-1), [(6, 1)]),
    (6, dict(trim_start=2, trim_end=3, after='LOOP'), [(2, 1)]),
    (6, dict(trim_start=2, trim_end=3, after='HIDE'), []),
    (1, dict(trim_start=50), [(9, 1)]),
    # the capture's frame is keyed
    (77, dict(capture_frame=4.25), [(4.25, 1)]), (77, dict(capture_frame=4.25, speed=-3, offset=2), [(4.25, 1)]),
    (77, dict(capture_frame=1, trim_start=3), [(3, 1)]), (77, dict(capture_frame=12, after='LOOP'), [(2, 1)]),
    # a loop that fades: 4 of 10 frames, so that it begins anew every 6
    (4, dict(after='LOOP', fade=4), [(3, 1)]), (7, dict(after='LOOP', fade=4), [(6, 1)]),
    (8, dict(after='LOOP', fade=4), [(1, 0.25), (7, 0.75)]),
    (10, dict(after='LOOP', fade=4), [(3, 0.75), (9, 0.25)]), (11, dict(after='LOOP', fade=4), [(4, 1)]),
    (14, dict(after='LOOP', fade=4), [(1, 0.25), (7, 0.75)]), (0, dict(before='LOOP', fade=4), [(5, 1)]),
    (2, dict(before='LOOP', fade=4), [(1, 0.25), (7, 0.75)]), (2, dict(after='LOOP', fade=4), [(1, 1)]),
    (10, dict(before='LOOP', fade=4), [(9, 1)]), (99, dict(before='LOOP', fade=4), [(9, 1)]),
    # echoes
    (9, dict(echoes=2, echo_spacing=3), [(8, 1), (5, 0.5), (2, 0.25)]), (4, dict(echoes=2, echo_spacing=3), [(3, 1), (0, 0.5)]),
    (3, dict(echoes=2, echo_spacing=-3, echo_fade=1), [(2, 1), (5, 1), (8, 1)]),
    (3, dict(echoes=1, echo_spacing=3, speed=-1), [(7, 1)]), (5, dict(echoes=1, echo_spacing=3, speed=-1), [(5, 1), (8, 0.5)]),
    (12, dict(echoes=1, echo_spacing=3, after='LOOP'), [(1, 1), (8, 0.5)]), (4, dict(echoes=9, echo_fade=0), [(3, 1)]),
])
def test_trims_keys_fades_and_echoes(show_all, frame, retime, expected):
    assert show_all(frame, **retime) == [(pytest.approx(f), pytest.approx(share)) for f, share in expected]


@given(frames, st.floats(0, 6), st.sampled_from(MODES), st.sampled_from(MODES), st.floats(0, 1e-3))
def test_a_fading_loop_has_no_seam(show_all, frame, fade, before, after, step):
    """Opacities add up to one, and from a moment to the next no frame comes or goes with more than a little of it."""
    first, second = (show_all(f, before=before, after=after, fade=fade) for f in (frame, frame + step))
    for shown in (first, second):
        assert not shown or sum(share for _, share in shown) == pytest.approx(1)
        assert all(0 <= f < 10 for f, _ in shown) and len(shown) == len(set(shown))
    if before == after == 'LOOP' and fade >= 1 and first and second:
        for f, share in first:
            near = sum(other for g, other in second if abs(f - g) <= step + ROUNDING)
            assert abs(near - share) <= (step + ROUNDING) / fade + 1e-3 or any(abs(f - g) < 2 * step + ROUNDING for g, _ in second)
