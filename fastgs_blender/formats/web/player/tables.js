// SPDX-License-Identifier: GPL-3.0-or-later
/** The shaders' parameters: kernels/gl/frame_table.py and resolve_table.py, whose places these are. */
import { LIBRARY } from "./library.js";
import { tangentLimits } from "./views.js";

const { HEAD, INSTANCE, LOOK_GRADED, NONE, POWERS, RESOLVE, RESOLVE_TEXELS, VIEW, WEIGHTS } = LIBRARY.tables;

/** Which instances are blended together (picture.grouped): [{space, view}], and the group of each. */
export function grouped(views) {
  const groups = [], known = new Map();
  const member = views.map((view) => {
    const { space, decoder } = view.kinds;
    const way = [space, decoder && [decoder.activation, decoder.decode, decoder.w1, decoder.w2, view.toModel, view.look.slice(LOOK_GRADED)]];
    const key = way.flat().join();
    if (!known.has(key)) known.set(key, groups.push({ space, view: decoder ? view : null }) - 1);
    return known.get(key);
  });
  return { groups, member };
}

/** How a basis reaches the shader: [NONE, WEIGHTS or POWERS, first run of weights, the runs themselves]. */
function runs(basis, t, size) {
  if (!basis.terms) return [NONE, 0, []];
  if (basis.centred) return [POWERS, 0, []];
  const weights = [...basis.weights(t)], listed = [];
  while (weights.length % size) weights.push(0);
  for (let k = 0; k < weights.length; k += size) listed.push(weights.slice(k, k + size));
  const used = listed.map((run) => run.some((w) => w !== 0)), first = used.indexOf(true);
  return first < 0 ? [WEIGHTS, 0, []] : [WEIGHTS, first, listed.slice(first, used.lastIndexOf(true) + 1)];
}

/**
 * {data, width, height} of the table of a frame.
 *
 * places  of each model: its first texels (geometry, colour) and its layout
 * member  number of the colour group of each view
 */
export function frameTable(camera, views, places, count, member, width) {
  const split = (n) => [Math.floor(n / width), n % width];
  const rows = [Object.values({
    ...rowOf(VIEW, {
      SIZE: [camera.width, camera.height, camera.fx, camera.fy], CENTRE: [camera.cx, camera.cy, +camera.orthographic, views.length],
      LIMITS: tangentLimits(camera), DEPTHS: [0, 0, 0, 0], COUNTS: [...split(count), 1, 1],
    }),
  })];
  views.forEach((view, number) => {
    const { kinds, t, first, rows: m, toModel, look, sampling } = view, { raster } = kinds, { geometry, colour, layout } = places[view.model];
    const [moving, moveFirst, moves] = runs(kinds.motion, t, 4), [turning, turnFirst, turns] = runs(kinds.turning, t, 1);
    const [changing, changeFirst, changes] = runs(kinds.changing, t, 1), eye = camera.orthographic ? 2 : 3;
    const head = Array.from({ length: HEAD }, () => [0, 0, 0, 0]), four = (list, k) => Array.from(list).slice(4 * k, 4 * k + 4);
    Object.assign(head, rowOf(INSTANCE, {
      TO_CAMERA: four(m, 0), EYE: [toModel[eye], toModel[4 + eye], toModel[8 + eye], +raster.antialiased],
      GEOMETRY: [...split(geometry), layout.geometry, layout.colours], COLOUR: [...split(colour), layout.colour, layout.degree],
      CHANGES: [changing, kinds.changing.terms, changeFirst, changes.length], TIME: [t, kinds.code, moving, layout.groups],
      BASES: [moveFirst, moves.length, turning, kinds.turns], GROUP: [turnFirst, turns.length, member[number], Math.floor(first / width)],
      RASTER: [view.near, raster.alpha_max, raster.alpha_cut, raster.blur], FIRST: [first % width, view.far, sampling.pixel, sampling.zoom],
      BEYOND: sampling.ball, SAMPLING: [sampling.coarse, sampling.least, sampling.reach, sampling.cameras.length],
    }));
    for (const k of [1, 2]) head[INSTANCE.TO_CAMERA + k] = four(m, k);
    for (let k = 0; k < look.length / 4; k++) head[INSTANCE.LOOK + k] = four(look, k);
    rows.push([...head, ...moves, ...[...turns, ...changes].map(([w]) => [w, 0, 0, 0]),
               ...sampling.cameras.flatMap((captured) => [four(captured, 0), four(captured, 1)])]);
  });
  const length = Math.max(...rows.map((row) => row.length)), data = new Float32Array(4 * length * rows.length);
  rows.forEach((row, y) => row.forEach((texel, x) => data.set(texel, 4 * (y * length + x))));
  return { data, width: length, height: rows.length };
}

function rowOf(names, texels) {
  return Object.fromEntries(Object.entries(texels).map(([name, texel]) => [names[name], texel]));
}

/** The table of a resolve pass over targets of the camera's size; for first, summed and raw see resolve_table(). */
export function resolveTable(camera, { space, view }, background, { first = true, summed = false, raw = false } = {}) {
  const data = new Float32Array(4 * RESOLVE_TEXELS), put = (place, values) => data.set(values, 4 * place), decoder = view && view.kinds.decoder;
  put(RESOLVE.KIND, [+(space === "srgb" && !raw), decoder ? decoder.activation : 0, +summed, +raw]);
  put(RESOLVE.BACKGROUND, [...background, 1]);
  put(RESOLVE.BORDER, [0, 0, 1, 1]);
  put(RESOLVE.WHOLE, [+first, 1, decoder ? decoder.decode : 0, 0]);
  put(RESOLVE.SIZE, [camera.width, camera.height, +camera.orthographic, 1]);
  put(RESOLVE.LENS, [camera.fx, camera.fy, camera.cx, camera.cy]);
  put(RESOLVE.WORKING, [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]);
  put(RESOLVE.FRAME, [0, 0, 1, 1]);
  if (decoder) {
    put(RESOLVE.TO_MODEL, view.toModel.subarray(0, 12));
    put(RESOLVE.W1, decoder.w1);
    const units = decoder.w2.length / 3;
    for (let h = 0; h < units; h++) put(RESOLVE.W2 + h, [0, 1, 2].map((k) => decoder.w2[k * units + h]));
    put(RESOLVE.LOOK, view.look);
  }
  return { data, width: RESOLVE_TEXELS, height: 1 };
}
