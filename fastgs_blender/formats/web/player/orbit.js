// SPDX-License-Identifier: GPL-3.0-or-later
/**
 * The camera in the user's hands.
 *
 * A view is {pivot [3], yaw, pitch, roll, distance}, angles in degrees: the eye is `distance` away from the pivot, which stays in the
 * middle of the picture.  A lens is {fx, fy, cx, cy, width, height, orthographic, of}, in pixels of the picture it was made for; `of` is
 * the distance at which a parallel projection has these focal lengths: nearer views show less.
 * Poses are camera to world, [16] row by row, in the library's axes: x right, y down, z forward.
 */
import { between as mixedPoses } from "./matrices.js";

const DEGREE = Math.PI / 180;
const STEEPEST = 89.5;
const COAST = 0.22; // seconds in which a flick's speed falls to a third
const FOLLOW = 0.045; // seconds in which two thirds of the way to the hand's view are gone
const FULL = 0.7; // how far lenses for windows of another shape go towards the one that fills the window
const RETURN = 0.8; // seconds of the way back to the opening view

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const sum = (a, b, by = 1) => a.map((x, k) => x + by * b[k]);
const unit = (a) => a.map((x) => x / (Math.hypot(...a) || 1));
const limited = (x, low, high) => Math.min(Math.max(x, low), high);
const turn = (degrees) => ((((degrees + 180) % 360) + 360) % 360) - 180;

/** The axes that yaw is counted from: [first, second, up]. */
function axes(up) {
  const above = unit(up), least = above.map(Math.abs).indexOf(Math.min(...above.map(Math.abs)));
  const near = [0, 1, 2].map((k) => Number(k === least)), first = unit(sum(near, above, -dot(near, above)));
  return [first, cross(above, first), above];
}

/** {right, down, forward, eye} of a view. */
export function frameOf(view, up) {
  const [first, second, above] = axes(up), { pivot, distance } = view, [yaw, pitch, roll] = [view.yaw, view.pitch, view.roll].map((x) => x * DEGREE);
  const away = [0, 1, 2].map((k) => Math.cos(pitch) * (Math.cos(yaw) * first[k] + Math.sin(yaw) * second[k]) + Math.sin(pitch) * above[k]);
  const forward = away.map((x) => -x), level = unit(cross(forward, above)), steep = cross(forward, level);
  const right = sum(level.map((x) => x * Math.cos(roll)), steep, Math.sin(roll));
  return { right, down: cross(forward, right), forward, eye: sum(pivot, away, distance) };
}

export function poseOf(view, up) {
  const { right, down, forward, eye } = frameOf(view, up);
  return Float64Array.from([...[0, 1, 2].flatMap((k) => [right[k], down[k], forward[k], eye[k]]), 0, 0, 0, 1]);
}

/** The view of a pose; its pivot is the point before the camera that is nearest to the given one. */
export function viewOf(pose, pivot, up, least = 1e-3) {
  const column = (k) => [pose[k], pose[4 + k], pose[8 + k]], [first, second, above] = axes(up);
  const eye = column(3), forward = unit(column(2)), right = unit(column(0));
  const between = sum(pivot, eye, -1), ahead = dot(between, forward), distance = Math.max(ahead > 0 ? ahead : Math.hypot(...between), least);
  const pitch = limited(Math.asin(limited(-dot(forward, above), -1, 1)) / DEGREE, -STEEPEST, STEEPEST);
  const side = sum(forward, above, -dot(forward, above)), steep = Math.hypot(...side) < 1e-6;
  // a camera that looks straight up or down has its yaw from where its upper edge points
  const heading = steep ? column(1).map((x) => x * Math.sign(dot(forward, above))) : side;
  const yaw = Math.atan2(-dot(heading, second), -dot(heading, first)) / DEGREE;
  const view = { pivot: sum(eye, forward, distance), yaw, pitch, roll: 0, distance };
  const { right: level, down } = frameOf(view, up);
  return { ...view, roll: Math.atan2(dot(right, down), dot(right, level)) / DEGREE };
}

/** A view turned around its pivot; what was tilted comes upright on the way. */
export function turned(view, yaw, pitch) {
  const upright = Math.exp(-(Math.abs(yaw) + Math.abs(pitch)) / 40);
  return { ...view, yaw: turn(view.yaw + yaw), pitch: limited(view.pitch + pitch, -STEEPEST, STEEPEST), roll: view.roll * upright };
}

/** Units of the world that a pixel covers at the pivot. */
function unitsOf(view, { fx, of }) {
  return view.distance / (fx * of);
}

/** A view moved so that what lies at the pivot's depth follows the hand by (x, y) pixels. */
export function panned(view, lens, up, x, y) {
  const { right, down } = frameOf(view, up), step = unitsOf(view, lens);
  return { ...view, pivot: sum(sum(view.pivot, right, -x * step), down, -y * step) };
}

/** A view whose distance is multiplied; the point at the pivot's depth under the pixel (x, y) stays where it is in the picture. */
export function dollied(view, lens, up, factor, x, y, [nearest, farthest]) {
  const distance = limited(view.distance * factor, nearest, farthest), share = 1 - distance / view.distance;
  const shift = (each) => share * each * unitsOf(view, lens), { right, down } = frameOf(view, up);
  return { ...view, distance, pivot: sum(sum(view.pivot, right, shift(x - lens.cx)), down, shift(y - lens.cy)) };
}

/** The view a share of the way from one to another. */
export function between(a, b, share) {
  const mixed = (x, y) => x + share * (y - x);
  return { pivot: a.pivot.map((x, k) => mixed(x, b.pivot[k])), yaw: turn(a.yaw + share * turn(b.yaw - a.yaw)), pitch: mixed(a.pitch, b.pitch),
           roll: turn(a.roll + share * turn(b.roll - a.roll)), distance: a.distance * (b.distance / a.distance) ** share };
}

/**
 * A lens for a window of another shape, between the one that fills it and the one that shows the whole picture: a wide picture on an
 * upright phone loses much of its sides, and gains a little above and below, where cameras of a capture have seldom looked.
 */
export function fitted(lens, width, height) {
  const [whole, full] = [width / lens.width, height / lens.height].sort((a, b) => a - b), scale = whole ** (1 - FULL) * full ** FULL;
  return { ...lens, width, height, fx: lens.fx * scale, fy: lens.fy * scale,
           cx: width / 2 + (lens.cx - lens.width / 2) * scale, cy: height / 2 + (lens.cy - lens.height / 2) * scale };
}

function mixedLens(a, b, share) {
  const numbers = ["fx", "fy", "cx", "cy", "width", "height", "of"].map((key) => [key, a[key] + share * (b[key] - a[key])]);
  return { ...b, ...Object.fromEntries(numbers) };
}

/** {pose, lens, view} of the opening cameras of a page's description at a frame. */
export function openingAt({ opening: { cameras }, pivot, up }, frame) {
  const at = limited(frame, 0, cameras.length - 1), first = Math.floor(at), share = at - first;
  const [a, b] = [first, Math.min(first + 1, cameras.length - 1)].map((k) => {
    const { pose, ...lens } = cameras[k], view = viewOf(pose, pivot, up);
    return { pose, lens: { ...lens, of: lens.orthographic ? view.distance : 1 }, view };
  });
  if (!share) return a;
  const pose = mixedPoses(a.pose, b.pose, share);
  return { pose, lens: mixedLens(a.lens, b.lens, share), view: viewOf(pose, pivot, up) };
}

/** The camera of a page: the opening move until a hand takes it, then an orbit. */
export class Orbit {
  /** description: the page's; calm: no opening move, no momentum. */
  constructor(description, calm = false) {
    Object.assign(this, { description, up: description.up, calm, size: [1, 1], frame: 0, moves: description.opening.moves && !calm });
    this.open();
    this.bound(null);
  }

  /** Sets how near and how far a hand may go, by a box {low, high} around the scene. */
  bound(box) {
    const size = Math.max(box ? Math.hypot(...sum(box.high, box.low, -1)) / 2 : 0, this.view.distance);
    this.limits = [size / 500, size * 20];
  }

  get opening() {
    return openingAt(this.description, this.moves ? this.frame : 0);
  }

  /** The opening has the camera. */
  open() {
    const { pose, lens, view } = this.opening;
    Object.assign(this, { taken: false, exact: pose, lens, view, goal: view, speed: null, held: false, home: null });
  }

  /** A hand has the camera: it stays where it is until told otherwise. */
  take() {
    Object.assign(this, { taken: true, home: null });
  }

  /** The camera for the renderer, for a picture of `scale` pixels for each of the window's. */
  camera(scale = 1) {
    const [width, height] = this.size.map((x) => Math.max(Math.round(x * scale), 1)), { of, ...lens } = fitted(this.lens, width, height);
    const nearer = lens.orthographic ? of / this.view.distance : 1;
    return { ...lens, fx: lens.fx * nearer, fy: lens.fy * nearer, pose: this.exact || poseOf(this.view, this.up) };
  }

  /** Goes on by dt seconds, at a frame of the scene; returns whether the camera moved. */
  step(dt, frame) {
    const { view } = this, went = this.moves && frame !== this.frame;
    this.frame = frame;
    if (this.home) this.approach(dt);
    else if (this.taken) this.glide(dt);
    else if (went) this.open();
    return this.view !== view;
  }

  /** On the way back to the opening view. */
  approach(dt) {
    const { opening, home } = this;
    home.time += dt;
    const at = Math.min(home.time / RETURN, 1), share = at * at * (3 - 2 * at);
    if (at === 1) this.open();
    else Object.assign(this, { exact: null, view: between(home.view, opening.view, share), lens: mixedLens(home.lens, opening.lens, share) });
  }

  /** After the hand. */
  glide(dt) {
    if (this.speed && !this.held) {
      const left = Math.exp(-dt / COAST);
      this.goal = turned(this.goal, ...this.speed.map((each) => each * COAST * (1 - left)));
      this.speed = this.speed.map((each) => each * left);
      if (Math.hypot(...this.speed) < 0.5) this.speed = null;
    }
    if (this.view === this.goal) return;
    const share = this.calm || distinct(this.view, this.goal) < 1e-4 ? 1 : 1 - Math.exp(-dt / FOLLOW);
    Object.assign(this, { exact: null, view: share < 1 ? between(this.view, this.goal, share) : this.goal });
  }

  /** Whether it moves by itself, so that another step() is due. */
  get busy() {
    return Boolean(this.home) || (this.taken && (this.view !== this.goal || Boolean(this.speed && !this.held)));
  }

  turn(yaw, pitch) {
    this.take();
    this.goal = turned(this.goal, yaw, pitch);
  }

  pan(x, y) {
    this.take();
    this.goal = panned(this.goal, fitted(this.lens, ...this.size), this.up, x, y);
  }

  dolly(factor, x = this.size[0] / 2, y = this.size[1] / 2) {
    this.take();
    this.goal = dollied(this.goal, fitted(this.lens, ...this.size), this.up, factor, x, y, this.limits);
  }

  /** A hand holds the picture. */
  hold() {
    this.take();
    Object.assign(this, { held: true, speed: null, goal: this.view });
  }

  /** The hand lets go, with a speed [yaw, pitch] in degrees a second. */
  release(speed = null) {
    Object.assign(this, { held: false, speed: this.calm ? null : speed });
  }

  /** Shows a view at once. */
  show(view) {
    this.take();
    Object.assign(this, { view, goal: view, speed: null, exact: null });
  }

  /** Back to the opening view, or its move. */
  reset() {
    Object.assign(this, { speed: null, held: false });
    if (this.calm || !this.taken) this.open();
    else this.home = { view: this.view, lens: this.lens, time: 0 };
    this.goal = this.view;
  }

  /** Ends all that moves by itself. */
  arrive() {
    if (this.home) this.open();
    this.speed = null;
    if (this.view !== this.goal) Object.assign(this, { view: this.goal, exact: null });
  }
}

/** How much two views differ, in shares of their distance and in turns. */
function distinct(a, b) {
  const apart = Math.hypot(...sum(a.pivot, b.pivot, -1)) / b.distance + Math.abs(Math.log(a.distance / b.distance));
  return apart + (Math.abs(turn(a.yaw - b.yaw)) + Math.abs(a.pitch - b.pitch) + Math.abs(turn(a.roll - b.roll))) * DEGREE;
}
