# SPDX-License-Identifier: GPL-3.0-or-later
"""A page in a browser, in a user's hands: mouse, fingers, keys, sizes, addresses, and what happens when something is missing."""
from __future__ import annotations

import math

import numpy as np
import pytest
from conftest import IN_BOTH
from held_runs import until
from knot_pages import SIZE, looking, sentence, state, visible

PHONE = (390, 844)
SHOWN = "({frame: fastgs.clock.frame, playing: fastgs.clock.playing, ...fastgs.orbit.goal, taken: fastgs.orbit.taken})"


def shown(tab):
    """The view that the hand wants, and the clock."""
    return tab.evaluate(SHOWN)


def arrived(tab):
    """The same, once the picture is there: a hand takes hold of what it sees."""
    tab.until("!fastgs.orbit.busy")
    return shown(tab)


def bright(picture):
    """Whether the poster is seen; a title and a sentence may lie over it."""
    return float((np.abs(picture.astype(int) - (250, 40, 160)).max(-1) < 8).mean()) > 0.3


@IN_BOTH
def test_a_page_plays_by_itself_without_a_request_or_a_complaint(opened):
    tab = opened(reduced_motion=False)
    tab.until("fastgs.clock.playing && fastgs.clock.time > 0.1")
    tab.until("getComputedStyle(document.getElementById('poster')).visibility === 'hidden'")
    assert visible(tab, "bar") and not visible(tab, "loading") and not visible(tab, "start")
    assert (tab.requests, tab.exceptions, tab.messages) == ([], [], [])
    assert tab.evaluate("document.title") == tab.evaluate("document.querySelector('h1').innerText") == "A knot & a disc"


def test_the_policy_lets_nothing_out(opened):
    tab = opened()
    refused = tab.evaluate("""new Promise((done) => {
        const seen = [];
        document.addEventListener("securitypolicyviolation", ({effectiveDirective}) =>
            seen.push(effectiveDirective) === 3 && done(seen.sort()));
        fetch("http://127.0.0.1:9/x").catch(() => {});
        new Image().src = "http://127.0.0.1:9/x.png";
        document.head.append(Object.assign(document.createElement("script"), {textContent: "window.ran = true"})); })""")
    assert refused == ["connect-src", "img-src", "script-src-elem"]
    assert not tab.evaluate("window.ran")
    tab.requests.clear()  # the browser names what it has refused


@IN_BOTH
def test_the_mouse_turns_moves_and_goes_nearer(opened):
    tab = opened()
    before = arrived(tab)
    tab.drag((200, 100), (230, 100), (260, 100))
    turned = arrived(tab)
    assert turned["yaw"] < before["yaw"] - 20 and turned["pitch"] == before["pitch"] and turned["pivot"] == pytest.approx(before["pivot"])
    tab.drag((200, 100), (200, 120), (200, 140))
    assert arrived(tab)["pitch"] > turned["pitch"] + 10
    for options in ({"button": "right"}, {"modifiers": 8}):
        before = arrived(tab)
        tab.drag((200, 100), (230, 110), (260, 120), **options)
        moved = arrived(tab)
        assert (moved["yaw"], moved["pitch"]) == (before["yaw"], before["pitch"])
        way = np.linalg.norm(np.subtract(moved["pivot"], before["pivot"]))
        assert way == pytest.approx(math.hypot(60, 20) * before["distance"] / 300, rel=1e-6)
    before = arrived(tab)
    tab.wheel(300, 100, -200)
    tab.until(f"fastgs.orbit.goal.distance < {0.8 * before['distance']}")
    assert not np.allclose(arrived(tab)["pivot"], before["pivot"])  # to what is under the pointer
    assert not tab.exceptions


def test_a_hand_that_trembles_does_not_turn(opened):
    tab = opened("move.html", reduced_motion=False)
    tab.drag((200, 100), (202, 101))
    assert not shown(tab)["taken"]


@IN_BOTH
def test_what_is_drawn_is_where_the_hand_wants_it(opened):
    tab = opened()
    before = tab.array("fastgs.settled().then(() => fastgs.renderer.pixels())")
    tab.drag((200, 100), (230, 100), (260, 100))
    after = tab.array("fastgs.settled().then(() => fastgs.renderer.pixels())")
    assert (before != after).mean() > 0.05
    tab.key("Home")
    again = tab.array("fastgs.settled().then(() => fastgs.renderer.pixels())")
    np.testing.assert_array_equal(before, again)


@IN_BOTH
def test_fingers_turn_pinch_and_move(opened):
    tab = opened(size=PHONE, touch=True)
    before = arrived(tab)
    tab.touch([(200, 300)], [(230, 300)], [(260, 300)])
    turned = arrived(tab)
    assert turned["yaw"] < before["yaw"] - 15 and turned["distance"] == before["distance"]
    tab.touch([(150, 400), (250, 400)], [(125, 400), (275, 400)], [(100, 400), (300, 400)])
    pinched = arrived(tab)
    assert pinched["distance"] == pytest.approx(turned["distance"] / 2, rel=0.02) and pinched["yaw"] == turned["yaw"]
    tab.touch([(150, 400), (250, 400)], [(150, 430), (250, 430)], [(150, 460), (250, 460)])
    moved = arrived(tab)
    assert moved["distance"] == pytest.approx(pinched["distance"], rel=0.02)
    assert np.linalg.norm(np.subtract(moved["pivot"], pinched["pivot"])) > 0.1
    assert not tab.exceptions


@IN_BOTH
def test_keys(opened):
    tab = opened()
    first = shown(tab)
    tab.key(" ")
    tab.until("fastgs.clock.playing && fastgs.clock.time > 0")
    tab.key(" ")
    assert not shown(tab)["playing"]
    tab.key("5")
    assert shown(tab)["frame"] == pytest.approx(19.5)
    tab.key(".")
    assert shown(tab)["frame"] == pytest.approx(20)
    tab.key(",")
    tab.key(",")
    assert shown(tab)["frame"] == pytest.approx(18)
    tab.key("ArrowLeft")
    tab.key("ArrowUp")
    turned = shown(tab)
    assert turned["yaw"] < first["yaw"] and turned["pitch"] > first["pitch"]
    tab.key("ArrowRight", modifiers=8)
    assert shown(tab)["pivot"] != turned["pivot"]
    tab.key("+")
    assert shown(tab)["distance"] < turned["distance"]
    tab.key("Home")
    assert not shown(tab)["taken"] and shown(tab)["yaw"] == first["yaw"]
    tab.key("?")
    assert tab.evaluate("document.getElementById('guide').open")
    tab.key("5")  # is not for the page behind
    assert shown(tab)["frame"] == pytest.approx(18)
    tab.key("Escape")
    tab.until("!document.getElementById('guide').open")
    assert not tab.exceptions


def test_full_screen(opened):
    tab = opened()
    tab.key("f")
    tab.until("document.fullscreenElement !== null && document.getElementById('full').getAttribute('aria-label') === 'Leave full screen'")
    tab.key("f")
    tab.until("document.fullscreenElement === null && document.getElementById('full').getAttribute('aria-label') === 'Full screen'")


def test_every_control_is_reached_by_tab_and_has_a_name(opened):
    tab = opened("loud.html", (900, 500))
    names = []
    for _ in range(9):
        tab.key("Tab")
        names.append(tab.evaluate("document.activeElement.id"))
    assert names == ["view", "play", "time", "speed", "mute", "reset", "link", "help", "full"]
    unnamed = tab.evaluate("[...document.querySelectorAll('button, input, canvas, dialog')].filter((e) => "
                           "!(e.getAttribute('aria-label') || e.getAttribute('aria-labelledby') || e.textContent.trim())).map((e) => e.id)")
    assert unnamed == []
    assert tab.evaluate("document.documentElement.lang") == "en"
    tab.evaluate("document.getElementById('play').focus()")
    tab.key(" ")  # presses the button once, and is no key of the page as well
    assert tab.until("fastgs.clock.playing")


def test_scrubbing_pauses_and_plays_on(opened):
    tab = opened(reduced_motion=False)
    tab.until("fastgs.clock.playing")
    x, y, width = tab.evaluate(
        "(({x, y, height, width}) => [x, y + height / 2, width])(document.getElementById('time').getBoundingClientRect())")
    tab.call("Input.dispatchMouseEvent", type="mousePressed", x=x + 0.3 * width, y=y, button="left", buttons=1, clickCount=1)
    tab.call("Input.dispatchMouseEvent", type="mouseMoved", x=x + 0.6 * width, y=y, button="left", buttons=1)
    held = shown(tab)
    assert not held["playing"] and held["frame"] == pytest.approx(0.6 * 39, abs=2)
    assert "seconds" in tab.evaluate("document.getElementById('time').getAttribute('aria-valuetext')")
    tab.call("Input.dispatchMouseEvent", type="mouseReleased", x=x + 0.6 * width, y=y, button="left", buttons=0, clickCount=1)
    assert tab.until("fastgs.clock.playing")
    tab.evaluate("fastgs.clock.pause(), document.getElementById('time').focus()")
    before = shown(tab)["frame"]
    tab.key("ArrowRight")
    assert shown(tab)["frame"] > before and not shown(tab)["taken"]  # the arrows are the slider's


def test_an_opening_move_goes_on_until_a_hand_comes(opened):
    tab = opened("move.html", reduced_motion=False)
    tab.until("fastgs.clock.frame > 5")
    tab.evaluate("fastgs.clock.pause(), fastgs.clock.seek(1), fastgs.orbit.step(0, fastgs.clock.frame)")
    expected = np.linalg.inv(looking(0.5 * 20 / 39))
    pose = tab.evaluate("[...fastgs.orbit.camera().pose]")
    np.testing.assert_allclose(np.reshape(pose, (4, 4)), expected, atol=1e-3)
    tab.drag((200, 100), (230, 100), (260, 100))
    yaw = shown(tab)["yaw"]
    tab.evaluate("fastgs.clock.seek(0.2)")
    tab.evaluate("fastgs.settled()")
    assert shown(tab)["taken"] and abs(shown(tab)["yaw"] - yaw) < 90  # a flick may run on, and the move is over


@IN_BOTH
def test_reduced_motion_plays_nothing_by_itself(opened):
    tab = opened("move.html")
    assert shown(tab)["playing"] is False and shown(tab)["frame"] == 0
    tab.key(" ")
    tab.until("fastgs.clock.frame > 2")
    pose = tab.evaluate("[...fastgs.orbit.camera().pose]")
    np.testing.assert_allclose(np.reshape(pose, (4, 4)), np.linalg.inv(looking(0)), atol=1e-9)
    tab.drag((200, 100), (230, 100), (260, 100))
    assert not tab.evaluate("fastgs.orbit.speed")


@IN_BOTH
def test_addresses_are_followed_and_made(opened, browser):
    tab = opened("knot.html#t=1.2&view=0.1,0.2,0.9,-40,25,4", reduced_motion=False)
    seen = shown(tab)
    assert (seen["frame"], seen["playing"], seen["yaw"], seen["distance"]) == (pytest.approx(24), False, -40, 4)
    tab.evaluate("location.hash = '#t=0.5&view=0,0,0,10,5,3'")
    tab.until("fastgs.orbit.goal.distance === 3")
    assert shown(tab)["frame"] == pytest.approx(10)
    tab.evaluate("navigator.clipboard.writeText = async (text) => { window.copied = text; }")
    tab.key("l")
    assert tab.until("window.copied") == f"{browser.address('knot.html')}#t=0.5&view=0,0,0,10,5,3"
    assert tab.until("document.getElementById('said').innerText")
    tab.evaluate("location.hash = '#t=never&view=1,2'")
    tab.evaluate("fastgs.settled()")
    assert shown(tab)["distance"] == 3 and state(tab) == "ready"


@pytest.mark.parametrize(("address", "wanted"), [("knot.html", "waiting"), ("knot.html#play=1", "ready")])
def test_a_page_in_another_page_waits_for_a_hand_unless_that_page_asks(browser, page, address, wanted):
    (browser.folder / "around.html").write_text(
        f'<!doctype html><body style="margin:0"><iframe src="{address}" width="440" height="240"></iframe>')
    tab = browser.open("around.html", SIZE)
    frame = tab.call("Page.getFrameTree")["frameTree"]["childFrames"][0]["frame"]["id"]
    world = tab.call("Page.createIsolatedWorld", frameId=frame)["executionContextId"]

    def said(expression):
        return tab.call("Runtime.evaluate", expression=expression, contextId=world, returnByValue=True)["result"].get("value")

    until(lambda: said("/waiting|ready|failed/.test(document.body.dataset.state)"))
    assert said("document.body.dataset.state") == wanted
    if wanted == "waiting":
        assert said("document.getElementById('model-0').textContent.length") > 100  # nothing is decoded yet
        tab.drag((220, 120))
        until(lambda: said("document.body.dataset.state") == "ready")
    until(lambda: said("document.getElementById('play').getAttribute('aria-label')") == "Pause")
    tab.close()


@IN_BOTH
def test_a_window_of_another_size_is_filled_again(opened):
    tab = opened()
    for (width, height), scale in (((700, 300), 1), (PHONE, 2), (PHONE, 3)):
        tab.resize(width, height, scale)
        tab.until(f"innerWidth === {width} && fastgs.orbit.size[1] === {height} && devicePixelRatio === {scale}")
        tab.evaluate("fastgs.settled()")
        sharp = min(scale, 2)  # more pixels are not to be seen
        assert tab.evaluate("[fastgs.renderer.canvas.width, fastgs.renderer.canvas.height]") == [width * sharp, height * sharp]
    assert tab.evaluate("document.documentElement.scrollWidth <= innerWidth")
    inside = tab.evaluate("[...document.querySelectorAll('#bar > :not([hidden])')].every((e) => { const r = e.getBoundingClientRect(); "
                          "return r.left >= 0 && r.right <= innerWidth && r.bottom <= innerHeight; })")
    assert inside


@IN_BOTH
def test_lost_graphics_come_back(opened):
    tab = opened()
    before = tab.array("fastgs.settled().then(() => fastgs.renderer.pixels())")
    tab.evaluate("window.lose = fastgs.renderer.canvas.getContext('webgl2').getExtension('WEBGL_lose_context'), lose.loseContext()")
    assert "come back" in tab.until("document.getElementById('notice').innerText")
    tab.evaluate("lose.restoreContext()")
    tab.until("document.getElementById('notice').innerText === ''")
    after = tab.array("fastgs.settled().then(() => fastgs.renderer.pixels())")
    np.testing.assert_array_equal(before, after)
    assert state(tab) == "ready" and not [each for each in tab.messages if "INVALID" in each]


def test_graphics_that_stay_lost_end_in_a_sentence(opened):
    tab = opened()
    tab.evaluate("fastgs.renderer.canvas.getContext('webgl2').getExtension('WEBGL_lose_context').loseContext()")
    tab.until("document.body.dataset.state === 'failed'")
    assert "Reload" in sentence(tab)


@IN_BOTH
def test_without_webgl2_a_sentence_says_so_and_the_poster_stays(opened):
    tab = opened(before="HTMLCanvasElement.prototype.getContext = () => null;")
    assert state(tab) == "failed" and "WebGL2" in sentence(tab)
    assert visible(tab, "poster") and not visible(tab, "bar") and not visible(tab, "loading")
    assert bright(tab.screenshot())


def test_without_javascript_the_poster_and_a_sentence_are_seen(browser, page):
    tab = browser.open("knot.html", SIZE, scripts=False)
    assert bright(tab.screenshot())
    text = tab.call("Runtime.evaluate", expression="document.body.innerText", returnByValue=True)["result"]["value"]
    assert "JavaScript" in text and "not started" not in text
    tab.close()


@IN_BOTH
def test_sound_is_silent_until_a_hand_wants_it_and_leads_the_clock(opened):
    tab = opened("loud.html", reduced_motion=False)
    tab.until("fastgs.clock.playing && fastgs.clock.sound.playing")
    assert tab.evaluate("fastgs.clock.sound.muted")
    tab.key("m")
    assert not tab.evaluate("fastgs.clock.sound.muted")
    tab.evaluate("fastgs.clock.pause(), fastgs.clock.seek(1.5)")
    assert tab.evaluate("fastgs.clock.sound.element.currentTime") == pytest.approx(1.5)
    assert tab.evaluate("fastgs.clock.sound.element.paused")


def test_colours_follow_the_system(opened):
    ink = {}
    for dark in (True, False):
        tab = opened(dark=dark)
        ink[dark] = tab.evaluate("getComputedStyle(document.getElementById('bar')).color")
    assert ink[True] == "rgb(242, 241, 238)" and ink[False] == "rgb(29, 29, 31)"


def test_a_still_scene_has_nothing_to_play(opened, page):
    page("still.html", frames=1)
    tab = opened("still.html", reduced_motion=False)
    assert not visible(tab, "play") and not visible(tab, "time") and visible(tab, "reset")
    tab.key(" ")
    tab.drag((200, 100), (230, 100), (260, 100))
    assert shown(tab)["taken"] and not shown(tab)["playing"] and not tab.exceptions


def test_a_page_that_is_not_looked_at_rests(opened):
    tab = opened(reduced_motion=False)
    tab.until("fastgs.clock.playing")
    for hidden in (True, False):
        tab.evaluate(f"Object.defineProperty(document, 'hidden', {{value: {str(hidden).lower()}, configurable: true}}), "
                     "document.dispatchEvent(new Event('visibilitychange'))")
        assert shown(tab)["playing"] is not hidden
