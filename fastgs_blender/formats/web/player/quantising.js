// SPDX-License-Identifier: GPL-3.0-or-later
/** From whole numbers to the arrays of a model: formats/quantising.py, restored().  Exact, or rounded once: the same model as in Python. */
import { damaged } from "./errors.js";
import { LIBRARY } from "./library.js";
import { isTable } from "./tensors.js";

const { ATTRIBUTES, BOUNDS, FINEST, LARGEST, LEAST_OPACITY, LIVES, SPREADS } = LIBRARY.quantising;
const POWERS = Float64Array.from({ length: 2046 }, (_, k) => 2 ** (k - 1022));
const bits = new Float64Array(1), words = new Uint32Array(bits.buffer);

const clamp = (x, low, high) => Math.min(Math.max(x, low), high);
const ldexp = (x, e) => x * POWERS[clamp(e, -1022, 1023) + 1022];
const rint = (x) => x + 6755399441055744 - 6755399441055744; // halves to even, below 2^51

/** e of x = m 2^e, 0.5 <= m < 1; x is positive and no denormal. */
function exponent(x) {
  bits[0] = x;
  return ((words[1] >>> 20) & 2047) - 1022;
}

/** The steps of a segment, checked: quantising.Steps. */
export class Steps {
  constructor(values, kinds) {
    const about = isTable(values) ? values : {};
    const width = kinds.width, whole = (v, most) => Number.isInteger(v) && Math.abs(v) <= most;
    const step = (v) => typeof v === "number" && v >= 2 ** -LARGEST && v <= 2 ** LARGEST;
    const list = (v, length, good) => Array.isArray(v) && v.length === length && v.every(good);
    const { base, tint, turn, motion, swing, chained, paired, least } = about;
    const good = isTable(base) && ATTRIBUTES.every((name) => step(base[name])) && list(tint, width, step)
      && list(turn, SPREADS, (v) => whole(v, LARGEST)) && whole(least, 200)
      && [[motion, kinds.terms], [swing, kinds.turns]].every(([table, terms]) =>
        list(table, LIVES, (row) => list(row, terms, (v) => whole(v, LARGEST))))
      && Array.isArray(chained) && Array.isArray(paired)
      && paired.every((pair) => list(pair, 2, (k) => Number.isInteger(k) && k >= 0 && k < width))
      && !paired.some(([k]) => paired.some(([, other]) => other === k));
    if (!good) throw damaged("its header does not say how finely its numbers are kept");
    Object.assign(this, { base, tint, turn, motion, swing, least, paired, chained: new Set(chained) });
  }

  of(name, shape) {
    return clamp(ldexp(this.base[name], shape), FINEST, BOUNDS[name]);
  }

  grain(scale, n, shape) {
    const [x, y, z] = [scale[3 * n], scale[3 * n + 1], scale[3 * n + 2]];
    const middle = Math.max(Math.min(x, y), Math.min(Math.max(x, y), z));
    return clamp(clamp(rint(middle * 1.4426950408889634), -200, 200) + exponent(this.of("position", shape)), this.least, 200);
  }

  turning(scale, n, shape) {
    return clamp(ldexp(this.of("rotation", shape), this.turn[spread(scale, n)]), FINEST, BOUNDS.rotation);
  }
}

/** By what other columns may be put in order once the scale is known. */
export function shapes(codes, steps) {
  const scale = scales(codes, steps), count = codes.shape[0].length;
  return {
    grain: Int32Array.from({ length: count }, (_, n) => steps.grain(scale, n, codes.shape[0][n])),
    spread: Int32Array.from({ length: count }, (_, n) => spread(scale, n)),
  };
}

function spread(scale, n) {
  const [x, y, z] = [scale[3 * n], scale[3 * n + 1], scale[3 * n + 2]];
  return clamp(rint((Math.max(x, y, z) - Math.min(x, y, z)) * 1.5), 0, SPREADS - 1);
}

function scales(codes, steps) {
  return attribute("scale", codes, steps, (n) => steps.of("scale", codes.shape[0][n]));
}

/** The values [N, D] of an attribute from its columns: values_of(). */
function attribute(name, codes, steps, step) {
  const columns = codes[name], width = columns.length, count = codes.shape[0].length, out = new Float64Array(count * width);
  columns.forEach((column, k) => {
    const chained = steps.chained.has(`${name}/${k}`);
    for (let n = 0, sum = 0; n < count; n++) {
      const value = column[n] * step(n, k);
      out[n * width + k] = chained ? (sum += value) : value;
    }
  });
  if (name === "features") {
    for (const [k, other] of steps.paired) for (let at = 0; at < out.length; at += width) out[at + k] += out[at + other];
  }
  return out;
}

/** Writes the arrays of a segment into those of a model, from Gaussian `first` on. */
export function restore(codes, steps, kinds, arrays, first) {
  const shape = codes.shape[0], tint = codes.tint[0], count = shape.length, scale = scales(codes, steps);
  const life = codes.life[0].map((value) => clamp(value, 0, LIVES - 1));
  const put = (name, values) => arrays[name].set(values, first * (values.length / Math.max(count, 1)));
  const grain = Float64Array.from({ length: count }, (_, n) => ldexp(1, steps.grain(scale, n, shape[n])));
  const fine = Float64Array.from({ length: count }, (_, n) => steps.turning(scale, n, shape[n]));
  const own = (name) => (n) => steps.of(name, shape[n]);
  put("scale", scale);
  put("features", attribute("features", codes, steps, (n, k) => clamp(ldexp(steps.tint[k], tint[n]), FINEST, BOUNDS.features)));
  put("mu_tau", attribute("mu_tau", codes, steps, (n) => ldexp(steps.of("mu_tau", shape[n]), -life[n])));
  put("opacity", attribute("opacity", codes, steps, own("opacity")).map((value) => {
    const opacity = clamp(value, LEAST_OPACITY, 1 - LEAST_OPACITY);
    return Math.log(opacity) - Math.log1p(-opacity);
  }));
  const sums = [0, 0, 0];
  for (let n = 0; n < count; n++) {
    for (let k = 0; k < 3; k++) arrays.position[3 * (first + n) + k] = sums[k] += codes.position[k][n] * grain[n];
    const at = 4 * (first + n), given = codes.rotation.length;
    let squares = 0;
    for (let k = 0; k < given; k++) {
      const value = codes.rotation[k][n] * fine[n];
      arrays.rotation[at + 4 - given + k] = value;
      squares += value * value;
    }
    if (given === 3) arrays.rotation[at] = Math.sqrt(Math.max(0.02, 1 - squares));
  }
  moved(codes.motion, grain, steps.motion, 3, life, arrays.motion, first);
  moved(codes.rotation_motion, fine, steps.swing, 4, life, arrays.rotation_motion, first);
  kinds.logarithms.forEach((logarithm, k) => {
    const width = kinds.logarithms.length;
    if (logarithm) {
      const values = attribute(`temporal.${k}`, codes, steps, own("temporal"));
      for (let n = 0; n < count; n++) arrays.temporal[(first + n) * width + k] = values[n];
    } else {
      const exact = new Uint32Array(arrays.temporal.buffer), [high] = codes[`temporal.${k}.high`], [low] = codes[`temporal.${k}.low`];
      for (let n = 0; n < count; n++) exact[(first + n) * width + k] = (high[n] << 16) | low[n];
    }
  });
}

/** Coefficients [N, K, D] of a basis from their columns, K * D of them. */
function moved(columns, fine, table, width, life, out, first) {
  columns.forEach((column, k) => {
    const powers = table.map((row) => POWERS[row[Math.floor(k / width)] + 1022]);
    for (let n = 0; n < column.length; n++) out[(first + n) * columns.length + k] = column[n] * (fine[n] * powers[life[n]]);
  });
}
