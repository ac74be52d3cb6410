// SPDX-License-Identifier: GPL-3.0-or-later
/** Which Gaussians a camera can see, the nearest first: kernels/cpu/visible.py and sort.py.  What instances are asked for says views.js. */
import { LIBRARY } from "./library.js";

const { LOOK, MARGIN, TEMPORAL } = LIBRARY.order;

/** Numbers of each Gaussian that do not change: 1 / opacity, and the longest axis. */
export function prepared({ count, arrays: { opacity, scale } }) {
  return {
    faintness: Float64Array.from(opacity, (value) => 1 + Math.exp(-value)),
    longest: Float64Array.from({ length: count }, (_, n) => Math.exp(Math.max(scale[3 * n], scale[3 * n + 1], scale[3 * n + 2]))),
  };
}

/** The factor of the opacity of Gaussian n at a time: equations/temporal.wgsl, in double precision. */
function temporalFactor(code, t, mu, p, at) {
  const { exp, max } = Math;
  if (code === TEMPORAL.radial) return exp(-exp(p[at]) * (t - mu) ** 2);
  if (code === TEMPORAL.window) {
    return exp(-((max(p[at] - t, 0) / exp(p[at + 2])) ** 2) - (max(t - p[at + 1], 0) / exp(p[at + 3])) ** 2);
  }
  if (code === TEMPORAL["radial-window"]) {
    return exp(-exp(p[at]) * (t - mu) ** 2 - (max(p[at + 1] - t, t - p[at + 2], 0) / exp(p[at + 3])) ** 2);
  }
  return 1;
}

/** What crops leave of the opacity at a place in the model: crops.crop_share(); shapes to keep come first. */
export function cropShare(crops, x, y, z) {
  let share = crops.length && !crops[0].remove ? 0 : 1;
  for (const { rows, remove, shape, soft, volume } of crops) {
    const [u, v, w] = [0, 4, 8].map((at) => rows[at] * x + rows[at + 1] * y + rows[at + 2] * z + rows[at + 3]);
    const depth = shape === "SPHERE" ? 1 - Math.hypot(u, v, w)
      : shape === "BOX" ? 1 - Math.max(Math.abs(u), Math.abs(v), Math.abs(w)) : volumeDepth(volume, u, v, w);
    if (!(depth >= 0)) continue;
    const s = depth / soft, inside = depth < soft ? s * s * (3 - 2 * s) : 1;
    share = remove ? share * (1 - inside) : Math.max(share, inside);
  }
  return share;
}

/** Volume.depth_at */
function volumeDepth({ side, depth }, u, v, w) {
  if (!(Math.abs(u) <= 1 && Math.abs(v) <= 1 && Math.abs(w) <= 1)) return -1;
  const grid = [u, v, w].map((x) => (x + 1) * 0.5 * (side - 1)), low = grid.map((x) => Math.min(Math.floor(x), side - 2));
  let sum = 0;
  for (let corner = 0; corner < 8; corner++) {
    const bits = [corner >> 2, (corner >> 1) & 1, corner & 1];
    const weight = bits.reduce((product, bit, axis) => product * (bit ? grid[axis] - low[axis] : 1 - grid[axis] + low[axis]), 1);
    sum += weight * depth[((low[0] + bits[0]) * side + low[1] + bits[1]) * side + low[2] + bits[2]];
  }
  return sum;
}

/** Sorts the Gaussians of instances for a view.  Keeps its memory from one order to the next. */
export class Sorter {
  constructor() {
    this.size = 0;
  }

  /** {count, list, channels}: places among all Gaussians, and where crops are soft what they take of each; `list` holds whole rows. */
  order({ instances, camera, width: rowWidth, volumes, list }, models) {
    const total = instances.reduce((sum, { model }) => sum + models[model].count, 0);
    if (total > this.size) {
      this.size = total;
      [this.keys, this.places, this.found, this.spare] = [Float32Array, Uint32Array, Uint32Array, Uint32Array].map((kind) => new kind(total));
      this.taken = new Float32Array(total);
    }
    let count = 0;
    for (const instance of instances) {
      const crops = instance.crops.map((crop) => ({ ...crop, volume: volumes[crop.volume] }));
      count = this.visible({ ...instance, crops }, models[instance.model], camera, instance.first, count);
    }
    const order = this.sorted(count), channels = instances.some(({ crops }) => crops.some(({ soft }) => soft > 0)) ? 2 : 1;
    const size = Math.max(Math.ceil(count / rowWidth), 1) * rowWidth * channels;
    const out = list && list.length >= size ? list : new Float32Array(size);
    for (let k = 0; k < count; k++) {
      out[k * channels] = this.places[order[k]];
      if (channels === 2) out[2 * k + 1] = this.taken[order[k]];
    }
    return { count, list: out, channels };
  }

  /** Culls one instance; see kernels/cpu/visible.py, whose lines these are, but for camera.around: pixels beyond the edges.  Returns how many have been written. */
  visible(instance, { kinds, arrays, faintness, longest, count }, camera, offset, out) {
    const { t, look, rows: m, near, far, ball, crops, sampling, stretch } = instance, { raster, motion, terms, logarithms, code } = kinds;
    const { position, mu_tau: centres, temporal } = arrays, parameters = logarithms.length, cut = raster.alpha_cut;
    const { fx, fy, cx, cy, width, height, orthographic, around } = camera, [spreadX, spreadY] = camera.spread.map((s) => s * stretch);
    const weights = motion.centred ? new Float64Array(terms) : motion.weights(t);
    const first = Math.max(weights.findIndex((w) => w !== 0), 0);
    let last = weights.length;
    while (last > first && !motion.centred && weights[last - 1] === 0) last--;
    const sized = look[LOOK.SIZED] !== 0, coefficients = arrays.motion;
    for (let n = 0; n < count; n++) {
      const bx = position[3 * n], by = position[3 * n + 1], bz = position[3 * n + 2];
      if ((bx - ball[0]) ** 2 + (by - ball[1]) ** 2 + (bz - ball[2]) ** 2 > ball[3] || faintness[n] > look[LOOK.FAINTEST]) continue;
      let sigma = temporalFactor(code, t, centres[n], temporal, parameters * n) / faintness[n] * look[LOOK.OPACITY];
      if (!(sigma >= cut)) continue;
      let px = 0, py = 0, pz = 0, power = 1;
      for (let k = first, at = 3 * (terms * n + first); k < last; k++, at += 3) {
        const w = motion.centred ? (power *= t - centres[n]) : weights[k];
        px += w * coefficients[at];
        py += w * coefficients[at + 1];
        pz += w * coefficients[at + 2];
      }
      px += bx;
      py += by;
      pz += bz;
      let taken = 0;
      if (crops.length) {
        const share = cropShare(crops, px, py, pz);
        taken = 1 - share;
        if (!((sigma *= share) >= cut)) continue;
      }
      const z = m[8] * px + m[9] * py + m[10] * pz + m[11];
      if (!(z > near && z <= far)) continue;
      const perDepth = orthographic ? 1 : 1 / z;
      const x = fx * (m[0] * px + m[1] * py + m[2] * pz + m[3]) * perDepth + cx, y = fy * (m[4] * px + m[5] * py + m[6] * pz + m[7]) * perDepth + cy;
      let size = longest[n], blur = raster.blur;
      if (sized) size = Math.min(Math.max(size * look[LOOK.SCALE], look[LOOK.SMALLEST]), look[LOOK.LARGEST]);
      size *= perDepth;
      if (sampling.pixel > 0) {
        const away = Math.hypot(px - sampling.ball[0], py - sampling.ball[1], pz - sampling.ball[2]) + sampling.ball[3];
        blur *= Math.max(Math.max(sampling.least, sampling.coarse * away) / (MARGIN * sampling.pixel * (orthographic ? 1 : z)), 1) ** 2;
      }
      const reach = Math.sqrt(2 * Math.log(sigma / cut));
      const radiusX = reach * Math.sqrt((size * spreadX) ** 2 + blur), radiusY = reach * Math.sqrt((size * spreadY) ** 2 + blur);
      const left = x + radiusX >= -around, right = x - radiusX <= width + around, above = y + radiusY >= -around, below = y - radiusY <= height + around;
      if (!(left && right && above && below)) continue;
      this.keys[out] = z;
      this.taken[out] = taken;
      this.places[out++] = offset + n;
    }
    return out;
  }

  /** Places in `keys`, the smallest first, equal ones in their order: by the bits of positive floats, eleven at a time. */
  sorted(count) {
    const bits = new Uint32Array(this.keys.buffer, 0, count), starts = new Uint32Array(2048);
    let { found, spare } = this;
    for (let n = 0; n < count; n++) found[n] = n;
    for (const shift of [0, 11, 22]) {
      starts.fill(0);
      for (let n = 0; n < count; n++) starts[(bits[n] >>> shift) & 2047]++;
      for (let k = 0, sum = 0; k < 2048; k++) [starts[k], sum] = [sum, sum + starts[k]];
      for (let n = 0; n < count; n++) spare[starts[(bits[found[n]] >>> shift) & 2047]++] = found[n];
      [found, spare] = [spare, found];
    }
    return found;
  }
}
