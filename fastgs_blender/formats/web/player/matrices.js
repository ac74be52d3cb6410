// SPDX-License-Identifier: GPL-3.0-or-later
/** Matrices of 4 x 4 numbers, row by row, in double precision. */

export function multiplied(a, b) {
  const out = new Float64Array(16);
  for (let i = 0; i < 4; i++) for (let j = 0; j < 4; j++) for (let k = 0; k < 4; k++) out[4 * i + j] += a[4 * i + k] * b[4 * k + j];
  return out;
}

/** Of an affine matrix; zeros where it has no inverse. */
export function inverse(m) {
  const [a, b, c, , d, e, f, , g, h, i] = m, det = determinant(m), out = new Float64Array(16);
  if (!det) return out;
  const minors = [e * i - f * h, c * h - b * i, b * f - c * e, f * g - d * i, a * i - c * g, c * d - a * f, d * h - e * g, b * g - a * h, a * e - b * d];
  for (let row = 0; row < 3; row++) {
    for (let k = 0; k < 3; k++) {
      out[4 * row + k] = minors[3 * row + k] / det;
      out[4 * row + 3] -= out[4 * row + k] * m[4 * k + 3];
    }
  }
  out[15] = 1;
  return out;
}

export function determinant([a, b, c, , d, e, f, , g, h, i]) {
  return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g);
}

/** The largest factor by which a matrix stretches a direction: the root of the largest eigenvalue of M^T M. */
export function stretch(m) {
  const dot = (j, k) => m[j] * m[k] + m[4 + j] * m[4 + k] + m[8 + j] * m[8 + k];
  const [xx, yy, zz, xy, xz, yz] = [dot(0, 0), dot(1, 1), dot(2, 2), dot(0, 1), dot(0, 2), dot(1, 2)];
  const mean = (xx + yy + zz) / 3, [x, y, z] = [xx - mean, yy - mean, zz - mean];
  const p = Math.sqrt((x * x + y * y + z * z + 2 * (xy * xy + xz * xz + yz * yz)) / 6);
  if (!(p > 0)) return Math.sqrt(mean);
  const half = (x * (y * z - yz * yz) - xy * (xy * z - yz * xz) + xz * (xy * yz - y * xz)) / (2 * p ** 3);
  return Math.sqrt(mean + 2 * p * Math.cos(Math.acos(Math.min(Math.max(half, -1), 1)) / 3));
}

/** A place between two: translation and stretch go straight, the rotation around one axis; a mirrored one goes straight as a whole. */
export function between(a, b, share) {
  const straight = (x, y) => x + (y - x) * share;
  const [from, to] = [parts(a), parts(b)];
  if (!from || !to) return Float64Array.from(a, (value, k) => straight(value, b[k]));
  let [w0, w1] = [1 - share, share], cosine = from.turn.reduce((sum, value, k) => sum + value * to.turn[k], 0);
  const angle = Math.acos(Math.min(Math.abs(cosine), 1));
  if (angle > 1e-6) [w0, w1] = [Math.sin(w0 * angle) / Math.sin(angle), Math.sin(w1 * angle) / Math.sin(angle)];
  if (cosine < 0) w1 = -w1;
  const turn = from.turn.map((value, k) => w0 * value + w1 * to.turn[k]), out = Float64Array.from(a, (value, k) => straight(value, b[k]));
  rotation(turn).forEach((value, k) => {
    out[4 * Math.floor(k / 3) + (k % 3)] = value * straight(from.size[k % 3], to.size[k % 3]);
  });
  return out;
}

/** The stretch of each axis and the unit quaternion w x y z of a matrix of both; null for any other. */
function parts(m) {
  const size = [0, 1, 2].map((k) => Math.hypot(m[k], m[4 + k], m[8 + k]));
  if (!(determinant(m) > 1e-30)) return null;
  const r = (i, k) => m[4 * i + k] / size[k], square = (k) => r(0, k) * r(0, (k + 1) % 3) + r(1, k) * r(1, (k + 1) % 3) + r(2, k) * r(2, (k + 1) % 3);
  if ([0, 1, 2].some((k) => Math.abs(square(k)) > 1e-6)) return null; // sheared
  const [xx, yy, zz] = [r(0, 0), r(1, 1), r(2, 2)], largest = Math.max(xx + yy + zz, xx, yy, zz);
  const turn = largest === xx + yy + zz ? [1 + largest, r(2, 1) - r(1, 2), r(0, 2) - r(2, 0), r(1, 0) - r(0, 1)]
    : largest === xx ? [r(2, 1) - r(1, 2), 1 + xx - yy - zz, r(0, 1) + r(1, 0), r(0, 2) + r(2, 0)]
      : largest === yy ? [r(0, 2) - r(2, 0), r(0, 1) + r(1, 0), 1 + yy - xx - zz, r(1, 2) + r(2, 1)]
        : [r(1, 0) - r(0, 1), r(0, 2) + r(2, 0), r(1, 2) + r(2, 1), 1 + zz - xx - yy];
  const length = Math.hypot(...turn);
  return { size, turn: turn.map((value) => value / length) };
}

function rotation([w, x, y, z]) {
  const n = w * w + x * x + y * y + z * z;
  return [1 - 2 * (y * y + z * z) / n, 2 * (x * y - w * z) / n, 2 * (x * z + w * y) / n,
          2 * (x * y + w * z) / n, 1 - 2 * (x * x + z * z) / n, 2 * (y * z - w * x) / n,
          2 * (x * z - w * y) / n, 2 * (y * z + w * x) / n, 1 - 2 * (x * x + y * y) / n];
}
