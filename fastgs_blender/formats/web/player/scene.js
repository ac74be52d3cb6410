// SPDX-License-Identifier: GPL-3.0-or-later
/** The scene of a page: what stands where at a time.  formats/web/page.py says what its description holds. */
import { basis } from "./bases.js";
import { Calls } from "./calls.js";
import { workerText } from "./data.js";
import { damaged } from "./errors.js";
import { between, multiplied } from "./matrices.js";
import { isCount, isTable } from "./tensors.js";

const FAR = 1e29; // numbers of looks beyond it stand for "no limit", and cannot be interpolated

/** Reads the models in a worker; payload(i): the bytes of model i; progress is called with 0..1. */
export async function openScene(description, payload, progress = () => {}) {
  const scene = new Scene(description), files = [];
  for (let i = 0; i < scene.modelCount; i++) files.push(payload(i));
  scene.calls = new Calls(workerText(description, "model_worker"));
  scene.models = await scene.calls.call("open", { files }, [...new Set(files.map(({ buffer }) => buffer))], progress);
  for (const { kinds } of scene.models) for (const name of ["motion", "turning", "changing"]) kinds[name] = basis(kinds[name].made);
  return scene;
}

export class Scene {
  constructor(description) {
    const numbers = (list, length) => Array.isArray(list) && list.length === length && list.every(Number.isFinite);
    const { version, objects, frames, fps, background, pivot, up, opening, volumes = [] } = isTable(description) ? description : {};
    const several = (list, good) => Array.isArray(list) && (list.length === 1 || list.length === frames) && list.every(good);
    const good = version === 1 && isCount(frames, 1e7) && frames > 0 && fps > 0 && [background, pivot, up].every((v) => numbers(v, 3))
      && isTable(opening) && several(opening.cameras, (camera) => isTable(camera) && numbers(camera.pose, 16))
      && Array.isArray(volumes) && Array.isArray(objects) && objects.every((each) => isTable(each) && isCount(each.model, objects.length)
        && several(each.places, (place) => numbers(place, 16)) && several(each.looks, (look) => numbers(look, 20))
        && several(each.crops, Array.isArray) && Array.isArray(each.times) && (!each.times.length || several(each.times, Number.isFinite))
        && (each.sampling === null || isTable(each.sampling)));
    if (!good) throw damaged("the description of its scene is of no version that it can play, or cut short");
    Object.assign(this, { ...description, models: [], calls: null });
    this.modelCount = objects.reduce((most, { model }) => Math.max(most, model + 1), 0);
    this.volumes = volumes.map(({ side, depth }) => {
      const bytes = Uint8Array.from(atob(depth), (letter) => letter.charCodeAt(0));
      if (!(isCount(side, 256) && bytes.length === 4 * side ** 3)) throw damaged("a shape that crops it is cut short");
      return { side, depth: new Float32Array(bytes.buffer) };
    });
  }

  get count() {
    return this.objects.reduce((sum, { model }) => sum + this.models[model].count, 0);
  }

  /** Low and high [3] of a box around nearly all of it, at the beginning. */
  get bounds() {
    const corners = this.objects.flatMap(({ model, places: [place] }) => {
      const { low, high } = this.models[model].span;
      return Array.from({ length: 8 }, (_, k) => {
        const corner = [0, 1, 2].map((axis) => ((k >> axis) & 1 ? high : low)[axis]), m = multiplied(place, translation(corner));
        return [m[3], m[7], m[11]];
      });
    });
    const of = (best) => [0, 1, 2].map((axis) => best(...corners.map((corner) => corner[axis])));
    return { low: of(Math.min), high: of(Math.max) };
  }

  /** The instances at a frame, counted from 0: {model, count, place, t, look, crops, backdrop, sampling}. */
  at(frame) {
    const now = Math.min(Math.max(frame, 0), this.frames - 1), first = Math.floor(now), share = now - first;
    return this.objects.map((each) => {
      const pick = (list, mixed) => {
        const [a, b] = [list[Math.min(first, list.length - 1)], list[Math.min(first + 1, list.length - 1)]];
        return share > 0 && a !== b ? mixed(a, b, share) : a;
      };
      const cameras = each.sampling && each.sampling.cameras;
      return {
        model: each.model, count: this.models[each.model].count, backdrop: each.backdrop, sampling: each.sampling && { ...each.sampling, cameras },
        place: pick(each.places, between), t: time(each.times, frame, this.frames), look: pick(each.looks, mixedLooks),
        crops: pick(each.crops, mixedCrops).map(({ matrix, ...crop }) => ({ ...crop, rows: matrix ? matrix.slice(0, 12) : Array(12).fill(NaN) }))
          .sort((a, b) => a.remove - b.remove),
      };
    });
  }
}

function translation([x, y, z]) {
  return [1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, z, 0, 0, 0, 1];
}

/** The model's time at a frame; where times jump from one frame to the next, the last pace goes on until then. */
export function time(times, frame, frames) {
  if (!times.length) return frame / frames;
  const last = times.length - 1, first = Math.min(Math.max(Math.floor(frame), 0), last), share = Math.min(Math.max(frame - first, 0), 1);
  const step = (k) => (k >= 0 && k < last ? times[k + 1] - times[k] : 0), pace = Math.max(Math.abs(step(first - 1)), Math.abs(step(first + 1)));
  const own = step(first), jumps = Math.abs(own) > 2 * pace + 1e-9 && pace > 0;
  return times[first] + share * (jumps ? step(first - 1) : own);
}

function mixedLooks(a, b, share) {
  return a.map((x, k) => (Math.max(x, b[k]) >= FAR ? (share < 0.5 ? x : b[k]) : x + share * (b[k] - x)));
}

/** crops.crops_between() */
function mixedCrops(a, b, share) {
  const near = share < 0.5 ? a : b;
  if (a.length !== b.length) return near;
  return near.map((crop, k) => {
    const [from, to] = [a[k].matrix, b[k].matrix];
    return from && to ? { ...crop, matrix: from.map((x, i) => x + share * (to[i] - x)) } : crop;
  });
}
