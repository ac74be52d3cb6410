// SPDX-License-Identifier: GPL-3.0-or-later
/** The scene of a page: what stands where at a time.  formats/web/page.py says what its description holds. */
import { basis } from "./bases.js";
import { Calls } from "./calls.js";
import { workerText } from "./data.js";
import { damaged } from "./errors.js";
import { between, multiplied } from "./matrices.js";
import { isCount, isTable } from "./tensors.js";

const FAR = 1e29; // numbers of looks beyond it stand for "no limit", and cannot be interpolated

/** Reads the models that a frame shows in a worker; payload(numbers): the promise of their files' bytes; progress is called with 0..1. */
export async function openScene(description, payload, frame = 0, progress = () => {}) {
  const scene = new Scene(description);
  scene.payload = payload;
  scene.calls = new Calls(workerText(description, "model_worker"));
  await scene.read(scene.wanted(frame)[0], progress);
  return scene;
}

export class Scene {
  constructor(description) {
    const numbers = (list, length) => Array.isArray(list) && list.length === length && list.every(Number.isFinite);
    const { version, objects: told, frames, fps, background, pivot, up, opening, volumes = [] } = isTable(description) ? description : {};
    const objects = Array.isArray(told) ? told.map((each) => (isTable(each) && isTable(told[each.like]) ? { ...told[each.like], ...each } : each)) : told;
    const several = (list, good) => Array.isArray(list) && (list.length === 1 || list.length === frames) && list.every(good);
    const good = version === 1 && isCount(frames, 1e7) && frames > 0 && fps > 0 && [background, pivot, up].every((v) => numbers(v, 3))
      && isTable(opening) && several(opening.cameras, (camera) => isTable(camera) && numbers(camera.pose, 16))
      && Array.isArray(volumes) && Array.isArray(objects) && objects.every((each) => isTable(each) && isCount(each.model, objects.length)
        && several(each.places, (place) => numbers(place, 16)) && several(each.looks, (look) => numbers(look, 20))
        && several(each.crops, Array.isArray) && Array.isArray(each.times) && (!each.times.length || several(each.times, Number.isFinite))
        && (each.sampling === null || isTable(each.sampling))
        && (!each.shown || (numbers(each.shown, 2) && numbers(each.clip, 2) && each.clip[1] > 0 && isCount(each.count, 2 ** 24))));
    if (!good) throw damaged("the description of its scene is of no version that it can play, or cut short");
    Object.assign(this, { ...description, objects, models: [], calls: null, before: [] });
    this.volumes = volumes.map(({ side, depth }) => {
      const bytes = Uint8Array.from(atob(depth), (letter) => letter.charCodeAt(0));
      if (!(isCount(side, 256) && bytes.length === 4 * side ** 3)) throw damaged("a shape that crops it is cut short");
      return { side, depth: new Float32Array(bytes.buffer) };
    });
  }

  /** The numbers of the models that a frame shows, and of those that are shown once another piece begins, or ends. */
  wanted(frame) {
    const shows = (each, t) => !each.shown || (t >= each.shown[0] && t < each.shown[1]), numbersAt = (at) =>
      [...new Set(this.objects.filter((each, k) => shows(each, at(each, k))).map(({ model }) => model))];
    const times = this.objects.map((each) => time(each.times, frame, this.frames));
    const seams = this.objects.flatMap(({ shown }, k) => (shown || []).filter((seam) => seam > times[k])), seam = Math.min(...seams);
    return [numbersAt((each, k) => times[k]), seams.length ? numbersAt(() => (seam < 1 ? seam : 0)) : []];
  }

  /** Reads models. */
  async read(numbers, progress = () => {}) {
    const files = await this.payload(numbers);
    const found = await this.calls.call("open", { numbers, files }, [...new Set(files.map(({ buffer }) => buffer))], progress);
    found.forEach((model, k) => {
      for (const name of ["motion", "turning", "changing"]) model.kinds[name] = basis(model.kinds[name].made);
      this.models[numbers[k]] = model;
    });
  }

  /** Forgets models. */
  drop(numbers) {
    for (const number of numbers) delete this.models[number];
    return this.calls.call("drop", { numbers });
  }

  /** Low and high [3] of a box around nearly all of it, at the beginning. */
  get bounds() {
    const corners = this.objects.filter(({ model }) => this.models[model]).flatMap(({ model, places: [place] }) => {
      const { low, high } = this.models[model].span;
      return Array.from({ length: 8 }, (_, k) => {
        const corner = [0, 1, 2].map((axis) => ((k >> axis) & 1 ? high : low)[axis]), m = multiplied(place, translation(corner));
        return [m[3], m[7], m[11]];
      });
    });
    const of = (best) => [0, 1, 2].map((axis) => best(...corners.map((corner) => corner[axis])));
    return { low: of(Math.min), high: of(Math.max) };
  }

  /**
   * The instances at a frame, counted from 0, of the models that are there: {model, first, there, place, t, look, crops, backdrop, sampling}.
   *
   * first: the place of its first Gaussian among those of all objects, which models that are not there have, too; there: whether it is shown
   */
  at(frame) {
    let following = 0;
    const now = Math.min(Math.max(frame, 0), this.frames - 1), first = Math.floor(now), share = now - first;
    return this.objects.flatMap((each) => {
      const model = this.models[each.model], begin = following, t = time(each.times, frame, this.frames);
      following += model ? model.count : each.count;
      if (!model) return [];
      const pick = (list, mixed) => {
        const [a, b] = [list[Math.min(first, list.length - 1)], list[Math.min(first + 1, list.length - 1)]];
        return share > 0 && a !== b ? mixed(a, b, share) : a;
      };
      const cameras = each.sampling && each.sampling.cameras;
      const [from, length] = each.clip || [0, 1];
      return [{
        model: each.model, first: begin, there: !each.shown || (t >= each.shown[0] && t < each.shown[1]), backdrop: each.backdrop,
        sampling: each.sampling && { ...each.sampling, cameras }, place: pick(each.places, between), t: (t - from) / length, look: pick(each.looks, mixedLooks),
        crops: pick(each.crops, mixedCrops).map(({ matrix, ...crop }) => ({ ...crop, rows: matrix ? matrix.slice(0, 12) : Array(12).fill(NaN) }))
          .sort((a, b) => a.remove - b.remove),
      }];
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
