# SPDX-License-Identifier: GPL-3.0-or-later
"""What a page's hands, clock and addresses compute, without a page.  Node runs it here; tests/blender drives pages in a browser."""
import json
import shutil
import subprocess
import zlib

import numpy as np
import pytest

from fastgs_blender.formats.web.page import PLAYER

pytestmark = pytest.mark.skipif(not shutil.which("node"), reason="node is not installed; tests/blender drives pages in a browser")
START = """
import * as orbit from "./orbit.js"; import * as address from "./address.js"; import { Clock, Sound } from "./clock.js";
import { shown } from "./controls.js"; import { Sharpness } from "./sharpness.js"; import { checksum } from "./checksum.js";
const view = {pivot: [1, 2, 3], yaw: -60, pitch: 20, roll: 0, distance: 4}, up = [0, 0, 1];
const lens = {fx: 500, fy: 500, cx: 320, cy: 180, width: 640, height: 360, orthographic: false, of: 1};
const said = (value) => console.log(JSON.stringify(value, (_, each) => (each instanceof Float64Array ? [...each] : each)));
"""


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """told(JavaScript): what it hands to said()."""
    folder = tmp_path_factory.mktemp("player")
    shutil.copytree(PLAYER, folder, dirs_exist_ok=True)
    (folder / "package.json").write_text('{"type": "module"}')

    def run(text: str):
        (folder / "told.js").write_text(START + text)
        done = subprocess.run(["node", folder / "told.js"], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return run


def looking(eye, target, up, roll=0.0):
    """Camera to world of a camera at `eye`: right, down, forward."""
    forward = np.subtract(target, eye) / np.linalg.norm(np.subtract(target, eye))
    level = np.cross(forward, up) / np.linalg.norm(np.cross(forward, up))
    right = np.cos(roll) * level + np.sin(roll) * np.cross(forward, level)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(forward, right), forward, eye], 1)
    return pose


@pytest.mark.parametrize("up", [(0, 0, 1), (0, -1, 0), (0.6, 0.0, 0.8)])
@pytest.mark.parametrize("roll", [0.0, 0.4])
def test_a_pose_becomes_a_view_and_is_the_same_again(told, up, roll):
    pose = looking((4, -3, 2), (1, 0.5, 1), up, roll)
    found, view = told(f"const v = orbit.viewOf({pose.ravel().tolist()}, [1.2, 0.4, 1], {list(up)});"
                       f"said([orbit.poseOf(v, {list(up)}), v]);")
    np.testing.assert_allclose(np.reshape(found, (4, 4)), pose, atol=1e-9)
    ahead = np.dot(np.subtract([1.2, 0.4, 1], (4, -3, 2)), pose[:3, 2])
    np.testing.assert_allclose(view["pivot"], pose[:3, 3] + ahead * pose[:3, 2], atol=1e-9)
    assert view["roll"] == pytest.approx(np.degrees(roll))


@pytest.mark.parametrize("side", [1, -1])
def test_a_camera_that_looks_straight_down_or_up_keeps_its_upper_edge(told, side):
    pose = np.array([[1, 0, 0, 0], [0, side, 0, 0], [0, 0, side, -3 * side], [0, 0, 0, 1.0]])
    found = told(f"said(orbit.poseOf(orbit.viewOf({pose.ravel().tolist()}, [0, 0, 0], up), up));")
    np.testing.assert_allclose(np.reshape(found, (4, 4)), pose, atol=0.03)


def test_what_a_hand_holds_stays_under_it(told):
    """A point at the pivot's depth follows the pointer, and stays where it is when the wheel goes nearer to it."""
    before, moved, near = told("""
        const at = (v) => orbit.poseOf(v, up);
        said([at(view), at(orbit.panned(view, lens, up, 30, -12)), at(orbit.dollied(view, lens, up, 0.5, 400, 100, [0.1, 100]))]);""")
    before, moved, near = (np.reshape(pose, (4, 4)) for pose in (before, moved, near))

    def pixel(pose, point):
        x, y, z = (np.linalg.inv(pose) @ [*point, 1])[:3]
        return 500 * x / z + 320, 500 * y / z + 180

    point = before[:3, 3] + 4 * (before[:3, 2] + 0.16 * before[:3, 0] - 0.16 * before[:3, 1])
    assert pixel(before, point) == pytest.approx((400, 100))
    assert pixel(moved, point) == pytest.approx((430, 88))
    assert pixel(near, point) == pytest.approx((400, 100))
    assert np.dot(near[:3, 3] - before[:3, 3], before[:3, 2]) == pytest.approx(2)


def test_a_turn_goes_around_the_pivot_and_ends_before_the_poles(told):
    side, top = told("said([orbit.turned(view, 90, 0), orbit.turned(view, 0, 500)]);")
    assert (side["yaw"], side["pivot"], side["distance"]) == (30, [1, 2, 3], 4)
    assert 89 < top["pitch"] < 90
    pose = np.reshape(told("said(orbit.poseOf({...view, yaw: 30}, up));"), (4, 4))
    other = np.reshape(told("said(orbit.poseOf(view, up));"), (4, 4))
    a, b = pose[:3, 3] - [1, 2, 3], other[:3, 3] - [1, 2, 3]
    assert a[2] == pytest.approx(b[2]) and np.dot(a[:2], b[:2]) == pytest.approx(0, abs=1e-9)
    assert np.linalg.norm(a) == pytest.approx(4)


@pytest.mark.parametrize(("size", "scale"), [((640, 360), 1), ((1280, 720), 2), ((320, 720), 0.5**0.3 * 2**0.7),
                                             ((1280, 360), 2**0.7)])
def test_a_window_of_another_shape_is_nearly_filled(told, size, scale):
    """It goes seven tenths of the way from the whole picture to one without a rim; the picture's middle stays in the middle."""
    width, height = size
    found = told(f"said(orbit.fitted({{...lens, cx: 330}}, {width}, {height}));")
    assert found["fx"] == found["fy"] == pytest.approx(500 * scale)
    assert (found["cx"], found["cy"]) == pytest.approx((width / 2 + 10 * scale, height / 2))


def test_parallel_projections_show_more_from_farther_away(told):
    cameras = told("""
        const pose = [1,0,0,0, 0,0,1,-5, 0,-1,0,0, 0,0,0,1], camera = {pose, ...lens, fx: 60, fy: 60, orthographic: true};
        const opening = {moves: false, cameras: [camera]};
        const o = new orbit.Orbit({opening, pivot: [0, 0, 0], up}, true); o.size = [640, 360];
        const first = o.camera(1); o.dolly(2); o.arrive(); said([first, o.camera(1), o.camera(2)]);""")
    assert [camera["fx"] for camera in cameras] == pytest.approx([60, 30, 60])
    assert cameras[2]["width"] == 1280 and "of" not in cameras[2]


MOVING = """
    const pose = (x) => [1,0,0,x, 0,0,1,-5, 0,-1,0,0, 0,0,0,1];
    const opening = {moves: true, cameras: [0, 1, 2].map((x) => ({pose: pose(x), ...lens}))};
    const made = (calm) => new orbit.Orbit({opening, pivot: [0, 0, 0], up}, calm);
"""


def test_the_opening_move_ends_when_a_hand_comes_and_begins_again_at_home(told):
    seen = told(MOVING + """
        const o = made(false), eye = () => o.camera().pose[3], seen = [];
        o.step(0.1, 0.5); seen.push(eye());
        o.hold(); o.turn(0, 0); o.release(); o.step(0.1, 1.5); seen.push(eye(), o.busy);
        o.reset(); for (let k = 0; k < 20; k++) o.step(0.1, 2); seen.push(eye(), o.taken);
        said(seen);""")
    assert seen == [pytest.approx(0.5), pytest.approx(0.5), False, pytest.approx(2), False]


def test_reduced_motion_has_no_opening_move_no_momentum_and_no_way_back(told):
    seen = told(MOVING + """
        const o = made(true), seen = [o.step(0.1, 1), o.camera().pose[3]];
        o.hold(); o.turn(30, 0); o.release([200, 0]); o.step(0.01, 1); seen.push(o.view.yaw - o.goal.yaw, o.busy);
        o.reset(); seen.push(o.taken, o.camera().pose[3]); said(seen);""")
    assert seen == [False, 0, 0, False, False, 0]


def test_a_flick_runs_out(told):
    yaw, count = told(MOVING + """
        const o = made(false); o.hold(); o.turn(0, 0); const before = o.view.yaw; o.release([100, 0]);
        let count = 0; while (o.busy && count < 1000) { o.step(1 / 60, 0); count++; } said([o.view.yaw - before, count]);""")
    assert yaw == pytest.approx(22, abs=1.0)  # 100 degrees a second, and its decay of 0.22 s
    assert count < 200


@pytest.mark.parametrize(("text", "time", "view"), [
    ("#t=1.2&view=1,2,-3,45,10,5", 1.2, {"pivot": [1, 2, -3], "yaw": 45, "pitch": 10, "roll": 0, "distance": 5}),
    ("#view=1,2,3,45,10,5,7", None, {"pivot": [1, 2, 3], "yaw": 45, "pitch": 10, "roll": 7, "distance": 5}),
    ("", None, None), ("#t=-1", None, None), ("#t=x&view=1,2", None, None), ("#t=1e400", None, None),
    ("#view=1,2,3,45,90,5", None, None), ("#view=1,2,3,45,10,-5", None, None), ("#view=,,,,,", None, None), ("#%E0%A4%A", None, None)])
def test_addresses_are_read(told, text, time, view):
    assert told(f"said(address.parsed({json.dumps(text)}));") == {"time": time, "view": view, "play": False}


def test_addresses_are_written_as_they_are_read(told):
    text, again = told("const v = {...view, yaw: 12.346, roll: -2, pivot: [1e-9, 20000.4, -3.25]}, text = address.written(1.23456, v);"
                       "said([text, address.parsed(text)]);")
    assert text == "#t=1.235&view=0,20000.4,-3.25,12.35,20,4,-2"
    assert again["view"]["distance"] == 4 and again["time"] == 1.235
    assert told("said(address.written(null, view));") == "#view=1,2,3,-60,20,4"


CLOCK = "let now = 10; const clock = (loop, sound = null) => new Clock({frames: 40, fps: 20, loop}, () => now, sound), seen = [];"


def test_the_clock_loops_or_stops_at_the_last_frame(told):
    seen = told(CLOCK + """
        const c = clock(true); c.play(); now += 0.5; c.step(); seen.push(c.time, c.frame);
        now += 1.75; c.step(); seen.push(c.time, c.playing);
        const d = clock(false); d.play(); now += 5; d.step(); seen.push(d.time, d.frame, d.playing); d.play(); seen.push(d.time);
        c.hasten(0.5); now += 0.5; const passed = c.time; c.before = now - 0.5; c.step(); seen.push(c.time - passed); said(seen);""")
    assert seen == pytest.approx([0.5, 10, 0.25, True, 1.95, 39, False, 0, 0.25])


def test_the_clock_steps_by_frames_and_pauses(told):
    seen = told(CLOCK + """
        const c = clock(true); c.play(); c.stepFrames(-1); seen.push(c.frame, c.playing); c.stepFrames(1); seen.push(c.frame);
        c.seek(0.512); c.stepFrames(1); seen.push(c.frame); c.seek(0.512); c.stepFrames(-1);
        seen.push(c.frame);
        const d = clock(false); d.stepFrames(-1); seen.push(d.frame); d.seek(99); d.stepFrames(1); seen.push(d.frame);
        d.seek(NaN); seen.push(d.time);
        said(seen);""")
    assert seen == pytest.approx([39, False, 0, 11, 10, 0, 39, 0])


def test_the_picture_follows_the_sound(told):
    """A sound that is late is waited for; one that is over leaves the clock alone."""
    seen = told(CLOCK + """
        const sound = {playing: true, time: 0, calls: [], seek(t) { this.calls.push(["seek", t]); },
            follow() {}, play() {}, pause() { this.calls.push("pause"); }};
        const c = clock(true, sound); c.play(); now += 0.5; c.step(); seen.push(c.time);
        sound.time = 0.52; now += 0.5; c.step(); seen.push(c.time);
        sound.playing = false; now += 0.25; c.step(); seen.push(c.time);
        c.pause(); seen.push(sound.calls); said(seen);""")
    assert seen[:3] == pytest.approx([0, 0.52, 0.77])
    assert seen[3] == [["seek", 0], "pause"]


def test_a_sound_begins_where_the_scene_reaches_it(told):
    """A sound that begins a second into the scene, and lasts for two."""
    seen = told("""
        const element = {currentTime: 0, duration: 2, paused: true,
            play() { this.paused = false; return Promise.resolve(); }, pause() { this.paused = true; }};
        const s = new Sound(element, -1), seen = [];
        s.play(0); seen.push(element.paused); s.follow(1.25); seen.push(element.paused, element.currentTime);
        s.seek(3.5); s.follow(3.5); seen.push(element.paused); s.pause(); s.follow(1.5); seen.push(element.paused); said(seen);""")
    assert seen == [True, False, 0.25, True, True]


def test_times_are_short(told):
    assert told("said([shown(0.56, 2), shown(1.95, 2), shown(61.2, 125)]);") == ["0.5 / 2.0 s", "1.9 / 2.0 s", "1:01 / 2:05"]


def test_slow_frames_have_fewer_pixels_and_still_ones_all(told):
    seen = told("""
        const s = new Sharpness(), seen = [s.scale(3, [400, 800], false)];
        for (let k = 0; k < 40; k++) s.took(0.08);
        seen.push(s.scale(3, [400, 800], false) < 1, s.scale(3, [400, 800], true), s.scale(2, [4000, 2000], true) < 1); said(seen);""")
    assert seen == [2, True, 2, True]


def test_checksums_are_those_of_zlib(told):
    data = bytes(range(256)) * 3 + b"end"
    assert told(f"said(checksum(Uint8Array.from({list(data)})));") == zlib.crc32(data)
