# SPDX-License-Identifier: GPL-3.0-or-later
"""Firefox as browser.py drives Chromium: the same tabs and hands, over WebDriver BiDi.  bidi_relay.py runs it, on a display of its own."""
from __future__ import annotations

import json
import sys
from pathlib import Path

from browser import OWN, Browser, Failed, Page

PREFERENCES = {
    "webgl.force-enabled": True,  # in software, too
    "network.proxy.type": 1, "network.proxy.http": "127.0.0.1", "network.proxy.http_port": 9, "network.proxy.ssl": "127.0.0.1",
    "network.proxy.ssl_port": 9, "network.proxy.allow_hijacking_localhost": True,  # nobody answers there: no network
    "app.update.enabled": False, "browser.aboutwelcome.enabled": False, "browser.shell.checkDefaultBrowser": False,
    "datareporting.policy.dataSubmissionEnabled": False, "media.autoplay.default": 1, "toolkit.cosmeticAnimations.enabled": False}
CALM = """(() => { const asked = window.matchMedia.bind(window);
    window.matchMedia = (query) => (/reduced-motion: reduce/.test(query) ? { matches: true } : asked(query)); })();"""
KEYS = {"ArrowLeft": 0xe012, "ArrowUp": 0xe013, "ArrowRight": 0xe014, "ArrowDown": 0xe015, "Home": 0xe011, "End": 0xe010, "Escape": 0xe00c,
        "Tab": 0xe004, "Enter": 0xe007}
MODIFIERS = {1: 0xe00a, 2: 0xe009, 8: 0xe008}
EVENTS = ["log.entryAdded", "network.beforeRequestSent"]


class Firefox(Browser):
    """A Firefox with its own profile, for the files in a folder."""

    def line(self, profile: Path) -> list[str]:
        texts = (f"user_pref({json.dumps(name)}, {json.dumps(value)});\n" for name, value in PREFERENCES.items())
        (self.profile / "user.js").write_text("".join(texts))
        python = "python3" if self.root else sys.executable
        return [python, "-c", Path(__file__).with_name("bidi_relay.py").read_text("utf-8"), str(profile), self.command, "--no-remote",
                "--profile", str(profile), "--remote-debugging-port", "0", *self.flags, "about:blank"]

    def greet(self) -> None:
        facts = self.call("session.new", capabilities={})["capabilities"]
        self.call("session.subscribe", events=EVENTS)
        self.version = f"Firefox/{facts['browserVersion']}"

    def heard(self, message: dict) -> None:
        facts = message["params"]
        page = self.pages.get(facts.get("context") or facts.get("source", {}).get("context"))
        if page:
            page.happened(message["method"], facts)

    def tab(self) -> FirefoxPage:
        return FirefoxPage(self, self.call("browsingContext.create", type="tab")["context"])


class FirefoxPage(Page):
    """A tab; see Page."""

    def call(self, method: str, **parameters) -> dict:
        return self.browser.call(method, context=self.session, **parameters)

    def prepare(self, size: tuple[int, int], touch: bool = False, scale: float = 1, reduced_motion: bool = False, before: str = "") -> None:
        """As Page.prepare(); fingers need no preparation here."""
        self.resize(*size, scale=scale)
        before = CALM * reduced_motion + before
        if before:
            self.browser.call("script.addPreloadScript", functionDeclaration=f"() => {{ {before} }}", contexts=[self.session])

    def happened(self, method: str, facts: dict) -> None:
        if method == "network.beforeRequestSent":
            address = facts["request"]["url"]
            if address.split("#")[0] != self.own and not address.startswith(OWN[1:]):
                self.requests.append(address)
        elif facts["type"] == "javascript" and facts["level"] == "error":
            self.exceptions.append(facts["text"])
        else:
            self.messages.append(f"{facts['level']}: {facts['text']}")

    def go(self, name: str) -> None:
        address = self.browser.address(name)
        self.own = address.split("#")[0]
        self.call("browsingContext.navigate", url=address, wait="complete")

    def evaluate(self, expression: str):
        answer = self.browser.call("script.evaluate", expression=f"(async () => JSON.stringify(await ({expression})))()", awaitPromise=True,
                                   target={"context": self.session}, userActivation=True)
        if answer["type"] == "exception":
            raise Failed(answer["exceptionDetails"]["text"])
        text = answer["result"].get("value")
        return None if text is None else json.loads(text)

    def picture(self) -> str:
        return self.call("browsingContext.captureScreenshot")["data"]

    def resize(self, width: int, height: int, scale: float = 1, mobile: bool = False) -> None:
        self.call("browsingContext.setViewport", viewport={"width": width, "height": height}, devicePixelRatio=scale)

    def perform(self, *sources: list[dict], kind: str = "pointer", pointer: str = "mouse") -> None:
        """Do what each source (a hand, a finger) has to do, side by side."""
        facts = {"parameters": {"pointerType": pointer}} if kind == "pointer" else {}
        listed = [{"type": kind, "id": f"{kind}-{pointer}-{n}", "actions": actions} | facts for n, actions in enumerate(sources)]
        self.call("input.performActions", actions=listed)

    def key(self, key: str, modifiers: int = 0) -> None:
        held = [chr(code) for bit, code in MODIFIERS.items() if modifiers & bit] + [chr(KEYS[key]) if key in KEYS else key]
        presses = [{"type": "keyDown", "value": each} for each in held]
        self.perform(presses + [{"type": "keyUp", "value": each} for each in held[::-1]], kind="key")

    def drag(self, *points: tuple[float, float], button: str = "left", modifiers: int = 0) -> None:
        number, held = {"left": 0, "middle": 1, "right": 2}[button], [chr(code) for bit, code in MODIFIERS.items() if modifiers & bit]
        for each in held:
            self.perform([{"type": "keyDown", "value": each}], kind="key")
        first, *others = [{"type": "pointerMove", "x": round(x), "y": round(y)} for x, y in points]
        self.perform([first, {"type": "pointerDown", "button": number}, *others, {"type": "pointerUp", "button": number}])
        for each in held:
            self.perform([{"type": "keyUp", "value": each}], kind="key")

    def wheel(self, x: float, y: float, down: float) -> None:
        self.perform([{"type": "scroll", "x": round(x), "y": round(y), "deltaX": 0, "deltaY": round(down)}], kind="wheel")

    def touch(self, *moments: list[tuple[float, float]]) -> None:
        fingers = [[{"type": "pointerMove", "x": round(x), "y": round(y)} for x, y in way] for way in zip(*moments)]
        down, up = ({"type": kind, "button": 0} for kind in ("pointerDown", "pointerUp"))
        self.perform(*([first, down, *others, up] for first, *others in fingers), pointer="touch")

    def close(self) -> None:
        self.call("browsingContext.close")
