// SPDX-License-Identifier: GPL-3.0-or-later
/** A model as the texels of two textures; kernels/gl/model_texels.py says how they lie. */
import { LIBRARY } from "./library.js";

const { APPEARANCES, SH_C0 } = LIBRARY.kinds;

/** How a model's texels are laid out: TexelLayout. */
export function layoutOf({ terms, turns, logarithms, appearance, degree, changing }) {
  const groups = Math.ceil(terms / 4), temporal = logarithms.length > 0;
  const colours = appearance === APPEARANCES.sh && !degree && !changing.terms ? APPEARANCES.rgb : appearance;
  const moment = { [APPEARANCES.rgb]: 1, [APPEARANCES.sh]: 3 * Math.ceil((degree + 1) ** 2 / 4), [APPEARANCES.features]: 3 }[colours];
  return { groups, temporal, colours, degree, geometry: 3 + temporal + turns + 3 * groups, colour: moment * (1 + changing.terms), moment };
}

/** Yields {row, texels} of one kind ("geometry" or "colour") of a model, `rows` rows of `width` texels at a time. */
export function* rowsOf(model, kind, width, rows) {
  const layout = layoutOf(model.kinds), run = new Float32Array(4 * layout[kind]), write = { geometry, colour }[kind];
  const size = Math.min(rows, rowCount(model, kind, width)) * width * 4;
  let texels = new Float32Array(size), at = 0, row = 0;
  for (let n = 0; n < model.count; n++) {
    write(model, layout, n, run);
    const fits = Math.min(run.length, size - at);
    for (let k = 0; k < fits; k++) texels[at++] = run[k];
    if (fits === run.length) continue;
    yield { row, texels };
    [texels, at, row] = [new Float32Array(size), 0, row + rows];
    for (let k = fits; k < run.length; k++) texels[at++] = run[k];
  }
  const left = Math.ceil(at / (4 * width)) * 4 * width;
  if (left) yield { row, texels: texels.slice(0, left) };
}

export function rowCount({ count, kinds }, kind, width) {
  return Math.max(Math.ceil((count * layoutOf(kinds)[kind]) / width), 1);
}

/** Row n of an array, whose rows have `size` numbers. */
function copy(array, size, n, out, at) {
  for (let k = 0; k < size; k++) out[at + k] = array[size * n + k];
}

/** Geometry of Gaussian n; one with NaN or infinity gets no opacity. */
function geometry({ kinds, arrays }, { groups, temporal }, n, run) {
  const { terms, turns, logarithms, width } = kinds, { features, motion } = arrays;
  run.fill(0);
  copy(arrays.position, 3, n, run, 0);
  run[3] = arrays.opacity[n];
  copy(arrays.rotation, 4, n, run, 4);
  copy(arrays.scale, 3, n, run, 8);
  run[11] = arrays.mu_tau[n];
  if (temporal) copy(arrays.temporal, logarithms.length, n, run, 12);
  const turned = temporal ? 16 : 12, moved = turned + 4 * turns;
  copy(arrays.rotation_motion, 4 * turns, n, run, turned);
  for (let axis = 0; axis < 3; axis++) {
    for (let k = 0; k < terms; k++) run[moved + 4 * groups * axis + k] = motion[3 * (terms * n + k) + axis];
  }
  let sum = 0; // 0 times NaN or infinity is NaN
  for (let k = 0; k < run.length; k++) sum += 0 * run[k];
  for (let k = width * n; k < width * (n + 1); k++) sum += 0 * features[k];
  if (sum === 0) return;
  run.fill(0);
  run[3] = -100;
}

function colour({ kinds: { own, width, changing, appearance }, arrays: { features } }, { colours, moment }, n, run) {
  run.fill(0);
  for (let term = 0; term <= changing.terms; term++) {
    for (let k = 0; k < own; k++) {
      const value = features[width * n + own * term + k], finite = Number.isFinite(value) ? value : 0;
      const at = 4 * moment * term + (colours === APPEARANCES.sh ? k : 4 * Math.floor(k / 3) + (k % 3));
      run[at] = colours !== appearance ? Math.max(0, 0.5 + SH_C0 * finite) : finite;
    }
  }
}
