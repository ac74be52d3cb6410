// SPDX-License-Identifier: GPL-3.0-or-later
/** The bases of time: model/motion.py and model/keyframes.py. */
import { damaged } from "./errors.js";
import { LIBRARY } from "./library.js";
import { isCount, isTable } from "./tensors.js";

const { LEAST_GAP, MAX_DEGREE, MAX_TERMS } = LIBRARY.kinds;

const oscillation = ({ order, scale = 1, offset = 0 }, turn, t, wave) => {
  for (let k = 1; k <= order; k++) wave(k - 1, turn * k * (scale * t + offset));
};

/** For each basis: whether its parameters are good, its terms, and what writes its weights at a time. */
const BASES = {
  static: { good: () => true, terms: () => 0, weights: () => {} },
  fourier: {
    good: (b) => isCount(b.order, MAX_TERMS / 2 - 1) && isReal(b.scale ?? 1) && isReal(b.offset ?? 0),
    terms: (b) => 2 * b.order + (b.linear ? 1 : 0),
    weights(b, t, out) {
      oscillation(b, 2 * Math.PI, t, (k, angle) => ([out[2 * k], out[2 * k + 1]] = [Math.sin(angle), Math.cos(angle)]));
      if (b.linear) out[2 * b.order] = t;
    },
  },
  cosine: {
    good: (b) => isCount(b.order, MAX_TERMS) && isReal(b.scale ?? 1) && isReal(b.offset ?? 0),
    terms: (b) => b.order,
    weights: (b, t, out) => oscillation(b, Math.PI, t, (k, angle) => (out[k] = Math.cos(angle))),
  },
  polynomial: { good: (b) => isCount(b.degree, MAX_DEGREE), terms: (b) => b.degree, centred: true },
  keyframes: {
    good: (b) => Array.isArray(b.times) && b.times.length > 0 && b.times.length <= MAX_TERMS && b.times.every(isReal)
      && b.times.every((t, k) => k === 0 || t - b.times[k - 1] >= LEAST_GAP) && ["linear", "catmull-rom"].includes(b.interpolation),
    terms: (b) => b.times.length,
    weights: between,
  },
};

function isReal(value) {
  return typeof value === "number" && Number.isFinite(value);
}

/** The basis that a file describes, checked; with `terms`, `centred`, weights(t), and `made`, what it is made of. */
export function basis(values) {
  const kind = isTable(values) && Object.hasOwn(BASES, values.name) ? BASES[values.name] : null;
  if (!kind || !kind.good(values)) throw damaged("its basis of time is unknown or has wrong parameters");
  const terms = kind.terms(values);
  return {
    made: values,
    terms,
    centred: Boolean(kind.centred),
    weights(t) {
      const out = new Float64Array(terms);
      if (!kind.centred) kind.weights(values, t, out);
      return out;
    },
  };
}

/** Keyframes._blend, of values. */
function between({ times, interpolation }, t, out) {
  const last = times.length - 1, inside = Math.min(Math.max(t, times[0]), times[last]);
  if (!last) return void (out[0] = 1);
  let i = 0, end = last;
  while (end - i > 1) {
    const middle = (i + end) >> 1;
    if (times[middle] <= inside) i = middle;
    else end = middle;
  }
  const h = times[i + 1] - times[i], u = (inside - times[i]) / h;
  if (interpolation === "linear") return void ([out[i], out[i + 1]] = [1 - u, u]);
  [out[i], out[i + 1]] = [2 * u ** 3 - 3 * u ** 2 + 1, -2 * u ** 3 + 3 * u ** 2];
  for (const [key, tangent] of [[i, h * (u ** 3 - 2 * u ** 2 + u)], [i + 1, h * (u ** 3 - u ** 2)]]) {
    const before = Math.max(key - 1, 0), after = Math.min(key + 1, last), chord = tangent / (times[after] - times[before]);
    out[after] += chord;
    out[before] -= chord;
  }
}
