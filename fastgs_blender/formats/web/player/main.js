// SPDX-License-Identifier: GPL-3.0-or-later
/** The page's start, its frames, and what becomes of it: loading, playing, lost graphics, sentences. */
import { parsed, written } from "./address.js";
import { Clock, Sound } from "./clock.js";
import { Controls, Hands } from "./controls.js";
import { arrived, bytesOf, described } from "./data.js";
import { PageError, damaged, sentence } from "./errors.js";
import { contextOf } from "./gl.js";
import { Orbit, fitted } from "./orbit.js";
import { Renderer } from "./renderer.js";
import { openScene } from "./scene.js";
import { Sharpness } from "./sharpness.js";

const $ = (id) => document.getElementById(id);
const PATIENCE = 5000; // milliseconds until graphics that are lost count as gone

const canvas = $("view"), address = parsed(location.hash), embedded = window.self !== window.top;
const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
const sharpness = new Sharpness();
const fastgs = (window.fastgs = { settled });
let due = false, fresh = true, before = 0, changed = 0, lost = false;

/** Ends the page in a sentence; the poster stays. */
function fail(error) {
  if (document.body.dataset.state === "failed") return;
  state("failed");
  $("notice").textContent = sentence(error);
  if (fastgs.clock && fastgs.clock.playing) fastgs.clock.pause();
  console.warn(error);
}

/** What the page is at: loading, waiting (for a hand to start it), ready or failed.  A page around this one hears it, too. */
function state(name) {
  document.body.dataset.state = name;
  if (embedded) window.parent.postMessage({ fastgs: name }, "*");
}

function loaded(share) {
  const percent = Math.round(100 * Math.min(share, 1));
  $("loading").setAttribute("aria-valuenow", percent);
  $("loading").style.setProperty("--share", share);
  $("share").textContent = `${percent} %`;
}

/** Makes the window's size that of the picture, and lays the poster where the picture will be. */
function measure() {
  const { orbit } = fastgs, poster = $("poster");
  orbit.size = [Math.max(window.innerWidth, 1), Math.max(window.innerHeight, 1)];
  if (poster) {
    const { fx } = fitted(orbit.opening.lens, ...orbit.size), { lens } = orbit.opening, scale = fx / lens.fx;
    Object.assign(poster.style, { width: `${lens.width * scale}px`, height: `${lens.height * scale}px` });
  }
  fresh = true;
  wake();
}

function draw(scale) {
  fastgs.renderer.draw(fastgs.orbit.camera(scale), fastgs.clock.frame);
}

function wake() {
  if (due || !fastgs.renderer) return;
  due = true;
  requestAnimationFrame(tick);
}

function tick(now) {
  due = false;
  if (lost || document.body.dataset.state === "failed") return;
  const { clock, orbit, controls } = fastgs, passed = Math.min((now - before) / 1000, 0.1);
  before = now;
  const went = clock.step(), moved = orbit.step(passed, clock.frame), busy = clock.playing || orbit.busy;
  if (went && controls) controls.show();
  if (went || moved || busy) changed = now;
  const still = now - changed > 200, scale = sharpness.scale(devicePixelRatio, orbit.size, still);
  if (!still && !fresh) sharpness.took(passed);
  try {
    if (went || moved || fresh || scale !== sharpness.drawn) draw((sharpness.drawn = scale));
  } catch (error) {
    fail(error);
    return;
  }
  fresh = false;
  if (busy || !still) wake();
}

/** Resolves once the picture is what the clock and the hands say, as sharp as it gets; for tests. */
async function settled() {
  await fastgs.ready;
  fastgs.orbit.arrive();
  draw((sharpness.drawn = sharpness.scale(devicePixelRatio, fastgs.orbit.size, true)));
  await fastgs.renderer.settled();
}

/** Goes to the moment and the view of an address. */
function follow({ time, view }) {
  const { clock, orbit } = fastgs;
  if (time !== null) {
    if (clock.playing) clock.pause();
    clock.seek(time);
    orbit.step(0, clock.frame);
  }
  if (view) orbit.show(view);
  fresh = true;
  wake();
}

function link() {
  const { clock, orbit } = fastgs;
  return location.href.split("#")[0] + written(clock.playing || !clock.moves ? null : clock.time, orbit.goal);
}

function opened(description) {
  try {
    return new Orbit(description, calm);
  } catch {
    throw damaged("the description of its scene is not what it should be");
  }
}

function soundOf(description) {
  const { type, start } = description.sound, element = new Audio(URL.createObjectURL(new Blob([bytesOf(description, "sound")], { type })));
  return new Sound(element, start);
}

/** Waits for a press on the button over the poster. */
function asked() {
  state("waiting");
  return new Promise((done) => $("start").addEventListener("click", done, { once: true }));
}

function graphicsLost(event) {
  event.preventDefault();
  lost = true;
  $("notice").textContent = "The graphics were interrupted, and come back by themselves.";
  setTimeout(() => lost && fail(new PageError("The browser has taken the graphics away. Reload the page to go on.")), PATIENCE);
}

async function graphicsBack() {
  try {
    if (fastgs.renderer) await fastgs.renderer.restore();
    $("notice").textContent = "";
    [lost, fresh] = [false, true];
    wake();
  } catch (error) {
    fail(error);
  }
}

/** Whether it plays while nobody looks: browsers stop drawing then. */
function hide() {
  const { clock } = fastgs;
  if (document.hidden) [hide.resume] = [clock.playing, clock.playing && clock.pause()];
  else if (hide.resume) clock.play();
  wake();
}

async function begin() {
  state("loading");
  loaded(0);
  if (getComputedStyle(document.body).overflow !== "hidden") throw damaged("its style is not as it was exported"); // the policy refuses it
  const description = await described(), orbit = (fastgs.orbit = opened(description)), pressed = embedded && !address.play;
  document.body.style.setProperty("--background", `color(srgb-linear ${description.background.join(" ")})`);
  window.addEventListener("resize", measure);
  measure();
  if (pressed) await asked();
  state("loading");
  canvas.addEventListener("webglcontextlost", graphicsLost);
  canvas.addEventListener("webglcontextrestored", graphicsBack);
  contextOf(canvas); // before anything is decoded: it may say that there is none
  const long = description.objects.some(({ shown }) => shown), frame = address.time === null ? 0 : address.time * description.fps;
  const payload = async (numbers) => {
    const names = numbers.map((number) => `model-${number}`), first = !fastgs.scene;
    await arrived(description, first && !long ? Object.keys(description.parts) : names, (share) => first && loaded(0.3 * share));
    return names.map((name) => bytesOf(description, name, long));
  };
  const scene = await openScene(description, payload, frame, (share) => loaded(0.3 + 0.6 * share));
  fastgs.scene = scene;
  orbit.bound(scene.bounds);
  if (description.sound) await arrived(description, ["sound"]);
  const sound = description.sound && soundOf(description);
  const clock = (fastgs.clock = new Clock(description, () => performance.now() / 1000, sound));
  const renderer = new Renderer(canvas, scene, () => {
    fresh = true;
    wake();
  });
  fastgs.renderer = renderer;
  follow(address);
  draw(sharpness.scale(devicePixelRatio, orbit.size, true));
  await renderer.settled();
  loaded(1);
  const player = { canvas, clock, orbit, sound, embedded, wake, link };
  fastgs.controls = new Controls(player);
  new Hands(player);
  state("ready");
  document.addEventListener("visibilitychange", hide);
  window.addEventListener("hashchange", () => follow(parsed(location.hash)));
  if (pressed) fastgs.controls.toggle();
  else if (!calm && address.time === null && !document.hidden) {
    if (sound) sound.muted = true;
    clock.play();
  } else hide.resume = !calm && address.time === null;
  wake();
}

if ($("unstarted")) $("unstarted").remove();
fastgs.ready = begin();
fastgs.ready.catch(fail);
window.addEventListener("error", ({ error }) => error && fail(error));
