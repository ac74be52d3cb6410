// SPDX-License-Identifier: GPL-3.0-or-later
/** The bar of a page, its keys, and hands on the picture. */
const SWEEP = 200; // degrees that a hand turns across the window's shorter side
const KEY_TURN = 6; // degrees
const TAP = 5; // pixels that a hand may tremble
const QUIET = 2800; // milliseconds until the bar goes while it plays

const $ = (id) => document.getElementById(id);

/** Seconds as a player shows them: minutes and seconds, of a short clip seconds and tenths. */
export function shown(time, length) {
  const [now, end] = length < 60 ? [time, length].map((each) => (Math.floor(each * 10 + 1e-6) / 10).toFixed(1)) : [time, length].map(minutes);
  return `${now} / ${end}${length < 60 ? " s" : ""}`;
}

function minutes(seconds) {
  const whole = Math.floor(seconds + 1e-6);
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
}

/** The bar.  player: {clock, orbit, sound, canvas, embedded, calm, wake(), link()} */
export class Controls {
  constructor(player) {
    Object.assign(this, { player, held: false });
    const { clock, sound } = player;
    this.screen = fullScreen(player.embedded);
    for (const id of ["play", "time", "clock", "speed"]) $(id).hidden = !clock.moves;
    $("mute").hidden = !sound;
    $("full").hidden = !this.screen;
    document.body.toggleAttribute("data-still", !clock.moves);
    document.body.toggleAttribute("data-silent", !sound);
    $("link").hidden = !/^(file|https?):/.test(location.protocol);
    Object.assign($("time"), { max: clock.last, step: "any" });
    this.listen();
    this.keys = keys(player, this);
    document.addEventListener("keydown", (event) => this.pressed(event));
    clock.onchange = () => this.show();
    this.show();
    this.stir();
  }

  listen() {
    const { clock, orbit, wake } = this.player, slider = $("time");
    const click = (id, action) => $(id).addEventListener("click", () => {
      action();
      wake();
    });
    click("play", () => this.toggle());
    click("speed", () => clock.hasten(clock.speed === 1 ? 0.5 : clock.speed === 0.5 ? 0.25 : 1));
    click("mute", () => this.mute());
    click("reset", () => orbit.reset());
    click("link", () => this.copy());
    click("help", () => $("guide").showModal());
    click("full", () => this.screen.toggle());
    $("guide").addEventListener("click", ({ target }) => target === $("guide") && $("guide").close());
    slider.addEventListener("pointerdown", () => {
      this.resume = clock.playing;
      this.held = true;
      if (clock.playing) clock.pause();
    });
    for (const end of ["pointerup", "pointercancel"]) {
      slider.addEventListener(end, () => {
        if (this.held && this.resume) clock.play();
        this.held = false;
        wake();
      });
    }
    slider.addEventListener("input", () => {
      if (!this.held && clock.playing) clock.pause();
      clock.seek(Number(slider.value));
      wake();
    });
    for (const event of ["pointermove", "pointerdown", "keydown", "focusin"]) document.addEventListener(event, () => this.stir());
    document.addEventListener("pointerleave", () => this.rest());
    document.addEventListener("fullscreenchange", () => this.show());
    document.addEventListener("webkitfullscreenchange", () => this.show());
  }

  toggle() {
    const { clock, sound } = this.player;
    if (sound && !clock.playing && !this.chosen) this.heard(true); // a hand has asked for it, so it may be heard
    clock.toggle();
  }

  mute() {
    const { sound } = this.player;
    if (sound) this.heard(sound.muted);
  }

  heard(heard) {
    this.chosen = true;
    this.player.sound.muted = !heard;
    this.show();
  }

  /** Puts a link to this view, and this moment where it pauses, into the clipboard. */
  async copy() {
    const link = this.player.link();
    try {
      await navigator.clipboard.writeText(link);
      this.say("The link is copied.");
    } catch {
      history.replaceState(null, "", link.slice(link.indexOf("#")));
      this.say("The link is in the address bar.");
    }
  }

  /** A short message, which goes by itself. */
  say(text) {
    $("said").textContent = text;
    clearTimeout(this.saying);
    this.saying = setTimeout(() => ($("said").textContent = ""), 2600);
  }

  /** Shows what the clock says. */
  show() {
    const { clock, sound } = this.player, slider = $("time"), time = Math.min(clock.time, clock.last);
    label("play", clock.playing ? "Pause" : "Play", "Space", clock.playing);
    if (document.activeElement !== slider || Math.abs(slider.value - time) > 1e-6) slider.value = time;
    slider.style.setProperty("--share", clock.last ? time / clock.last : 0);
    slider.setAttribute("aria-valuetext", `${time.toFixed(1)} of ${clock.last.toFixed(1)} seconds`);
    $("clock").textContent = shown(time, clock.length);
    $("speed").textContent = { 0.125: "⅛×", 0.25: "¼×", 0.5: "½×", 1: "1×", 2: "2×" }[clock.speed];
    $("speed").setAttribute("aria-label", `Speed: ${clock.speed}`);
    if (sound) label("mute", sound.muted ? "Sound on" : "Sound off", "M", !sound.muted);
    if (this.screen) label("full", this.screen.on() ? "Leave full screen" : this.screen.label, "F", this.screen.on());
    if (!clock.playing) this.stir();
  }

  /** Somebody is there: the bar shows, and goes again while the clip plays. */
  stir() {
    delete document.body.dataset.idle;
    clearTimeout(this.quiet);
    this.quiet = setTimeout(() => this.rest(), QUIET);
  }

  rest() {
    const used = this.held || $("guide").open || document.querySelector("#bar :focus-visible, #bar:hover");
    if (this.player.clock.playing && !used) document.body.dataset.idle = "";
  }

  pressed(event) {
    const { key, target } = event, own = target.closest("button, a, input, dialog");
    if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented) return;
    if (own && (own.matches("dialog") || (own.matches("button, a") && (key === " " || key === "Enter")) || own.closest("dialog"))) return;
    if (own && own.matches("input") && /^(Arrow|Home|End|Page)/.test(key)) return;
    const action = this.keys[event.shiftKey && key.startsWith("Arrow") ? `Shift ${key}` : key] || (/^\d$/.test(key) && this.keys.digit);
    if (!action) return;
    event.preventDefault();
    action(key);
    this.player.wake();
  }
}

function label(id, text, key, pressed) {
  const button = $(id);
  button.setAttribute("aria-label", text);
  button.title = `${text} (${key})`;
  button.dataset.on = pressed;
}

/** What each key does. */
function keys({ clock, orbit }, controls) {
  const turn = (yaw, pitch) => () => orbit.turn(yaw * KEY_TURN, pitch * KEY_TURN);
  const pan = (x, y) => () => orbit.pan((x * orbit.size[0]) / 20, (y * orbit.size[0]) / 20);
  const near = () => orbit.dolly(0.9), far = () => orbit.dolly(1 / 0.9), full = () => controls.screen && controls.screen.toggle();
  const still = {
    "ArrowLeft": turn(-1, 0), "ArrowRight": turn(1, 0), "ArrowUp": turn(0, 1), "ArrowDown": turn(0, -1),
    "Shift ArrowLeft": pan(1, 0), "Shift ArrowRight": pan(-1, 0), "Shift ArrowUp": pan(0, 1), "Shift ArrowDown": pan(0, -1),
    "+": near, "=": near, "-": far, "PageUp": near, "PageDown": far, "Home": () => orbit.reset(), "f": full, "F": full,
    "m": () => controls.mute(), "M": () => controls.mute(), "l": () => controls.copy(), "L": () => controls.copy(), "?": () => $("guide").showModal(),
  };
  const moving = {
    " ": () => controls.toggle(), "k": () => controls.toggle(), "K": () => controls.toggle(), ",": () => clock.stepFrames(-1), ".": () => clock.stepFrames(1),
    "<": () => clock.faster(-1), ">": () => clock.faster(1), "digit": (key) => clock.seek((clock.last * Number(key)) / 10),
  };
  return clock.moves ? { ...still, ...moving } : still;
}

/** {toggle(), on(), label}, or null where there is no full screen, as on iPhones: there the page has the screen already. */
function fullScreen(embedded) {
  const page = document.documentElement, ask = page.requestFullscreen || page.webkitRequestFullscreen;
  const on = () => Boolean(document.fullscreenElement || document.webkitFullscreenElement);
  if (ask && (document.fullscreenEnabled || document.webkitFullscreenEnabled)) {
    const leave = () => (document.exitFullscreen || document.webkitExitFullscreen).call(document);
    return { on, label: "Full screen", toggle: () => Promise.resolve(on() ? leave() : ask.call(page)).catch(() => {}) };
  }
  if (!embedded || !/^(file|https?):/.test(location.protocol)) return null;
  return { on: () => false, label: "Open in a tab of its own", toggle: () => window.open(location.href, "_blank", "noopener") };
}

/** Hands on the picture: mouse, fingers, pen, wheel. */
export class Hands {
  constructor({ canvas, orbit, wake, embedded }) {
    Object.assign(this, { canvas, orbit, wake, embedded, down: new Map(), trail: [] });
    const on = (name, act, options) => canvas.addEventListener(name, (event) => act.call(this, event), options);
    on("pointerdown", this.press);
    on("pointermove", this.move);
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) on(end, this.lift);
    on("wheel", this.wheel, { passive: false });
    on("contextmenu", (event) => event.preventDefault());
    on("gesturestart", (event) => {
      event.preventDefault();
      this.pinch = 1;
    });
    on("gesturechange", (event) => { // Safari's trackpads
      event.preventDefault();
      if (!this.down.size) this.near(this.pinch / event.scale, event.clientX, event.clientY);
      this.pinch = event.scale;
    });
  }

  press(event) {
    if (this.down.size > 1) return;
    this.canvas.setPointerCapture(event.pointerId);
    this.canvas.focus({ preventScroll: true });
    const { clientX: x, clientY: y, timeStamp: time } = event;
    this.pans = event.pointerType !== "touch" && (event.button === 2 || event.shiftKey);
    this.down.set(event.pointerId, { x, y });
    this.start = { x, y };
    this.moved = false;
    this.trail = [{ x, y, time }];
    if (event.button === 1) event.preventDefault();
  }

  move(event) {
    const finger = this.down.get(event.pointerId), { clientX: x, clientY: y } = event;
    if (!finger) return;
    if (!this.moved && Math.hypot(x - this.start.x, y - this.start.y) < TAP && this.down.size === 1) return;
    if (!this.moved) {
      Object.assign(this, { moved: true });
      this.orbit.hold();
      this.canvas.dataset.held = "";
    }
    const before = this.middle();
    const [dx, dy] = [x - finger.x, y - finger.y];
    Object.assign(finger, { x, y });
    if (this.down.size > 1) this.two(before, this.middle());
    else if (this.pans) this.orbit.pan(dx, dy);
    else this.orbit.turn(...this.angles(dx, dy));
    this.trail.push({ x, y, time: event.timeStamp });
    this.wake();
  }

  /** Two fingers carry the picture and stretch it. */
  two(before, after) {
    this.orbit.pan(after.x - before.x, after.y - before.y);
    if (after.apart > 0 && before.apart > 0) this.orbit.dolly(before.apart / after.apart, after.x, after.y);
  }

  middle() {
    const [a, b = a] = this.down.values();
    return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, apart: Math.hypot(a.x - b.x, a.y - b.y) };
  }

  angles(x, y) {
    const each = SWEEP / Math.min(...this.orbit.size);
    return [-x * each, y * each];
  }

  lift(event) {
    if (!this.down.delete(event.pointerId)) return;
    this.trail = this.trail.filter(({ time }) => event.timeStamp - time < 90);
    const [first] = this.trail, last = this.trail.at(-1), seconds = first ? (last.time - first.time) / 1000 : 0;
    const flick = !this.down.size && !this.pans && this.moved && event.type === "pointerup" && seconds > 0.015;
    this.trail = [];
    if (this.down.size) return;
    delete this.canvas.dataset.held;
    if (this.moved) this.orbit.release(flick ? this.angles((last.x - first.x) / seconds, (last.y - first.y) / seconds) : null);
    this.wake();
  }

  wheel(event) {
    if (this.embedded && !document.hasFocus()) return; // the other page scrolls
    event.preventDefault();
    const lines = [1, 16, 400][event.deltaMode], way = Math.min(Math.max(event.deltaY * lines, -300), 300);
    this.near(Math.exp(way * (event.ctrlKey ? 0.01 : 0.0015)), event.clientX, event.clientY);
  }

  near(factor, x, y) {
    this.orbit.dolly(factor, x, y);
    this.wake();
  }
}
