# SPDX-License-Identifier: GPL-3.0-or-later
"""Browsers without a network, driven over a pipe: they open pages as a double click does.

    with launched("chromium", folder) as browser:
        page = browser.open("page.html")
        page.evaluate("document.title")

The browser is this machine's, or that of a Debian root (tools/blender_root.sh), which has no network at all.  Chromium, without a window,
speaks the DevTools protocol; Firefox (firefox.py) has the same tabs and hands, for less: what a test needs beyond them is Chromium's.
"""
from __future__ import annotations

import base64
import fcntl
import io
import json
import os
import select
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from blenders import TOOLS
from held_runs import GUARD, until
from PIL import Image

FLAGS = ("headless", "no-sandbox", "use-angle=swiftshader", "enable-unsafe-swiftshader", "remote-debugging-pipe", "mute-audio",
         "no-first-run", "disable-dev-shm-usage", "disable-background-networking", "disable-component-update",
         "disable-background-timer-throttling", "disable-renderer-backgrounding", "hide-scrollbars",
         "host-resolver-rules=MAP * ~NOTFOUND")
KEYS = {" ": ("Space", 32), "ArrowLeft": ("ArrowLeft", 37), "ArrowUp": ("ArrowUp", 38), "ArrowRight": ("ArrowRight", 39),
        "ArrowDown": ("ArrowDown", 40), "Home": ("Home", 36), "End": ("End", 35), "Escape": ("Escape", 27), "Tab": ("Tab", 9),
        "Enter": ("Enter", 13)}
"""Key -> its code and its number; letters and digits need none."""
OWN = ("file:", "data:", "blob:")
"""Addresses that do not leave the page's own file, but for another file's."""


class Failed(AssertionError):
    """The page or the browser refused."""


def launched(command: str, folder: Path, root: Path | str = "") -> Browser:
    """The browser that a command starts, for a with statement; see Browser."""
    if "firefox" not in command:
        return Browser(folder, root, command, FLAGS)
    from firefox import Firefox  # which needs this module

    return Firefox(folder, root, command)


class Browser:
    """A browser with its own profile, for the files in a folder: a Chromium."""

    def __init__(self, folder: Path, root: Path | str = "", command: str = "chromium", flags: tuple[str, ...] = FLAGS):
        self.folder, self.root = Path(folder), str(root)
        self.command, self.flags = command, [f"--{flag}" for flag in flags]

    def __enter__(self) -> Browser:
        home = f"profile-{self.command}"
        self.profile = Path(tempfile.mkdtemp(prefix=home, dir=self.folder))
        line = self.line(Path("/mnt") / self.profile.name if self.root else self.profile)
        if self.root:
            line = [str(TOOLS / "in_root.sh"), self.root, str(self.folder), *line]
        (theirs_in, self.to), (self.come, theirs_out) = _pipe(), _pipe()
        with (self.profile / "log.txt").open("w") as log:
            pipes = f'exec "$@" 3<&{theirs_in} 4>&{theirs_out} {theirs_in}<&- {theirs_out}>&-'
            self.process = subprocess.Popen(["bash", "-c", pipes, "_", *line], pass_fds=(theirs_in, theirs_out), stdin=subprocess.DEVNULL,
                                            stdout=log, stderr=log)
        os.close(theirs_in)
        os.close(theirs_out)
        self.rest, self.number, self.answers, self.pages = b"", 0, {}, {}
        try:
            self.greet()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_) -> None:
        os.close(self.to)  # the browser ends with its pipe
        try:
            self.process.wait(20)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        os.close(self.come)
        shutil.rmtree(self.profile, ignore_errors=True)

    def line(self, profile: Path) -> list[str]:
        """The command line, for a profile's folder as the browser sees it."""
        return [self.command, *self.flags, f"--user-data-dir={profile}", "about:blank"]

    def greet(self) -> None:
        """The first words: who it is."""
        self.version = self.call("Browser.getVersion")["product"]

    def call(self, method: str, session: str | None = None, **parameters) -> dict:
        """The result of a method of the protocol; events that come before it reach their pages."""
        number = self.send(method, session, **parameters)
        while number not in self.answers:
            self.receive()
        answer = self.answers.pop(number)
        if "error" in answer:
            raise Failed(f"{method}: {answer.get('message') or answer['error']['message']}")
        return answer["result"]

    def send(self, method: str, session: str | None = None, **parameters) -> int:
        """Begin a call, and return its number."""
        self.number += 1
        message = {"id": self.number, "method": method, "params": parameters} | ({"sessionId": session} if session else {})
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self.to, data):]
        return self.number

    def receive(self, patience: float = GUARD) -> bool:
        """Wait for what comes next; whether something came."""
        while b"\0" not in self.rest:
            if not select.select([self.come], [], [], patience)[0]:
                if patience < GUARD:
                    return False
                raise Failed(f"the browser has said nothing for {patience:.0f} s")
            data = os.read(self.come, 1 << 20)
            if not data:
                raise Failed("the browser ended by itself\n" + (self.profile / "log.txt").read_text(errors="replace")[-3000:])
            self.rest += data
        message, self.rest = self.rest.split(b"\0", 1)
        message = json.loads(message)
        if message.get("id") is not None:
            self.answers[message["id"]] = message
        elif "method" in message:
            self.heard(message)
        return True

    def heard(self, message: dict) -> None:
        """Hand an event to its page."""
        if message.get("sessionId") in self.pages:
            self.pages[message["sessionId"]].happened(message["method"], message["params"], message["sessionId"])

    def address(self, name: str) -> str:
        """The file: address of a file in the folder, as the browser sees it; the name may end in #..."""
        return f"file:///mnt/{name}" if self.root else f"{self.folder.resolve().as_uri()}/{name}"

    def cpu_seconds(self) -> float:
        """Seconds of processor that all processes of the browser have used."""
        return sum(process["cpuTime"] for process in self.call("SystemInfo.getProcessInfo")["processInfo"])

    def open(self, name: str | None = None, size: tuple[int, int] = (640, 360), **options) -> Page:
        """A new tab with a file of the folder, loaded; without a name, an empty one.  `options` are those of Page.prepare()."""
        page = self.tab()
        page.prepare(size, **options)
        if name is not None:
            page.go(name)
        return page

    def tab(self) -> Page:
        """A new tab, empty."""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        return Page(self, self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"], target)


def _pipe() -> list[int]:
    """Both ends of a pipe, with numbers that are not in the way of 3 and 4."""
    ends = os.pipe()
    moved = [fcntl.fcntl(end, fcntl.F_DUPFD_CLOEXEC, 20) for end in ends]
    for end in ends:
        os.close(end)
    return moved


class Page:
    """A tab.

    requests    addresses that the page or its workers asked for, but for the file itself, data: and blob:
    messages    what it wrote to the console, as "level: text"
    exceptions  what nobody caught
    """

    def __init__(self, browser: Browser, session: str, target: str = ""):
        self.browser, self.session, self.target = browser, session, target
        self.requests: list[str] = []
        self.messages: list[str] = []
        self.exceptions: list[str] = []
        self.workers: list[str] = []
        self.loaded, self.own = False, "about:blank"
        browser.pages[session] = self

    def call(self, method: str, **parameters) -> dict:
        return self.browser.call(method, self.session, **parameters)

    def prepare(self, size: tuple[int, int], touch: bool = False, scripts: bool = True, scale: float = 1, reduced_motion: bool = False,
                dark: bool = False, before: str = "") -> None:
        """Set what the tab is like; `before` is JavaScript that runs before the page's own."""
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")
        self.call("Target.setAutoAttach", autoAttach=True, waitForDebuggerOnStart=True, flatten=True)
        self.resize(*size, scale=scale, mobile=touch)
        self.call("Emulation.setTouchEmulationEnabled", enabled=touch)
        self.call("Emulation.setScriptExecutionDisabled", value=not scripts)
        self.call("Emulation.setEmulatedMedia", features=[
            {"name": "prefers-reduced-motion", "value": "reduce" if reduced_motion else "no-preference"},
            {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}])
        if before:
            self.call("Page.addScriptToEvaluateOnNewDocument", source=before)

    def happened(self, method: str, facts: dict, session: str) -> None:
        """Keep what an event says."""
        if method == "Page.loadEventFired":
            self.loaded = True
        elif method == "Network.requestWillBeSent":
            address = facts["request"]["url"]
            if address.split("#")[0] != self.own and not address.startswith(OWN[1:]):
                self.requests.append(address)
        elif method == "Runtime.exceptionThrown":
            details = facts["exceptionDetails"]
            self.exceptions.append(details.get("exception", {}).get("description") or details["text"])
        elif method == "Runtime.consoleAPICalled":
            said = " ".join(str(each.get("value", each.get("description", ""))) for each in facts["args"])
            self.messages.append(f"{facts['type']}: {said}")
        elif method == "Log.entryAdded":
            self.messages.append(f"{facts['entry']['level']}: {facts['entry']['text']}")
        elif method == "Target.attachedToTarget":  # a worker: its requests and errors are the page's
            self.browser.pages[facts["sessionId"]] = self
            self.workers.append(facts["sessionId"])
            for each in ("Network.enable", "Runtime.enable", "Runtime.runIfWaitingForDebugger"):
                self.browser.send(each, facts["sessionId"])

    def go(self, name: str) -> None:
        """Open a file of the folder, and wait until it is loaded."""
        address = self.browser.address(name)
        self.loaded, self.own = False, address.split("#")[0]
        self.call("Page.navigate", url=address)
        while not self.loaded:
            self.browser.receive()

    def evaluate(self, expression: str):
        """The value of a JavaScript expression, awaited; it must be plain data."""
        result = self.call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True, userGesture=True)
        if "exceptionDetails" in result:
            details = result["exceptionDetails"]
            raise Failed(details.get("exception", {}).get("description") or details["text"])
        return result["result"].get("value")

    def array(self, expression: str) -> np.ndarray:
        """The bytes [n] uint8 of a typed array that an expression gives."""
        text = self.evaluate(f"""(async () => {{
            const array = await ({expression}), bytes = new Uint8Array(array.buffer, array.byteOffset, array.byteLength);
            let text = "";
            for (let i = 0; i < bytes.length; i += 32768) text += String.fromCharCode(...bytes.subarray(i, i + 32768));
            return btoa(text); }})()""")
        return np.frombuffer(base64.b64decode(text), np.uint8)

    def until(self, expression: str, guard: float = GUARD):
        """Wait until an expression gives something true, and return that."""
        return until(lambda: self.evaluate(expression), guard)

    def rest(self) -> None:
        """Let the page draw no frame by itself any more; one that is due is drawn before this returns."""
        self.evaluate("""new Promise((drawn) => {
            const next = window.requestAnimationFrame;
            window.requestAnimationFrame = () => 0;
            next(drawn); })""")

    def screenshot(self, file: Path | None = None) -> np.ndarray:
        """What the tab shows, RGB [h, w, 3] uint8; also written as a PNG where a file is named."""
        data = base64.b64decode(self.picture())
        if file is not None:
            Path(file).write_bytes(data)
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))

    def picture(self) -> str:
        """The base64 of a PNG of what the tab shows."""
        return self.call("Page.captureScreenshot", format="png")["data"]

    def resize(self, width: int, height: int, scale: float = 1, mobile: bool = False) -> None:
        """Another size of the tab, in CSS pixels."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=scale, mobile=mobile)

    def key(self, key: str, modifiers: int = 0) -> None:
        """Press and let go a key, named as KeyboardEvent.key names it; modifiers: 1 Alt, 2 Ctrl, 8 Shift."""
        code, number = KEYS.get(key) or (f"Key{key.upper()}" if key.isalpha() else f"Digit{key}", ord(key.upper()))
        text = {"text": "\r" if key == "Enter" else key} if len(key) == 1 or key == "Enter" else {}
        self.call("Input.dispatchKeyEvent", type="keyDown" if text else "rawKeyDown", key=key, code=code, windowsVirtualKeyCode=number,
                  modifiers=modifiers, **text)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=key, code=code, windowsVirtualKeyCode=number, modifiers=modifiers)

    def drag(self, *points: tuple[float, float], button: str = "left", modifiers: int = 0) -> None:
        """Press the mouse at the first point, move through the others and let go; one point is a click."""
        down = {"left": 1, "right": 2, "middle": 4}[button]
        common = {"button": button, "modifiers": modifiers, "clickCount": 1}
        self._mouse("mouseMoved", points[0], buttons=0, modifiers=modifiers)
        self._mouse("mousePressed", points[0], buttons=down, **common)
        for point in points[1:]:
            self._mouse("mouseMoved", point, buttons=down, **common)
        self._mouse("mouseReleased", points[-1], buttons=0, **common)

    def wheel(self, x: float, y: float, down: float) -> None:
        """Turn the wheel over a point, by pixels towards the user."""
        self._mouse("mouseWheel", (x, y), deltaX=0, deltaY=down)

    def _mouse(self, kind: str, point: tuple[float, float], **facts) -> None:
        self.call("Input.dispatchMouseEvent", type=kind, x=point[0], y=point[1], **facts)

    def touch(self, *moments: list[tuple[float, float]]) -> None:
        """Put fingers down at the first moment's points, move them to each next one's, and lift them all."""
        for i, fingers in enumerate(moments):
            points = [{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(fingers)]
            self.call("Input.dispatchTouchEvent", type="touchMove" if i else "touchStart", touchPoints=points)
        self.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])

    def metrics(self) -> dict[str, float]:
        """The browser's figures of the tab, such as JSHeapUsedSize, ScriptDuration and TaskDuration (seconds)."""
        self.call("Performance.enable", timeDomain="threadTicks")
        return {each["name"]: each["value"] for each in self.call("Performance.getMetrics")["metrics"]}

    def memory(self) -> list[float]:
        """Bytes that the page's JavaScript holds, and that of each of its workers, with all arrays, after a collection."""
        held = []
        for session in (self.session, *self.workers):
            self.browser.call("HeapProfiler.collectGarbage", session)
            found = self.browser.call("Runtime.getHeapUsage", session)
            held.append(found["usedSize"] + found["backingStorageSize"])
        return held

    def close(self) -> None:
        """Close the tab."""
        self.browser.call("Target.closeTarget", targetId=self.target)
