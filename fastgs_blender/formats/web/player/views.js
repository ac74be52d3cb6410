// SPDX-License-Identifier: GPL-3.0-or-later
/** Instances before a camera: rendering/instances.py (ViewedInstance) and cameras/camera.py. */
import { LIBRARY } from "./library.js";
import { determinant, inverse, multiplied, stretch } from "./matrices.js";

const { LIMIT, WITHIN } = LIBRARY.view;

/** Camera.tangent_limits() */
export function tangentLimits({ width, height, fx, fy, cx, cy }) {
  const ascending = (size, f, c) => [-c / f - 0.15 * size / f, (size - c) / f + 0.15 * size / f].sort((a, b) => a - b);
  return [...ascending(width, fx, cx), ...ascending(height, fy, cy)];
}

/** culling.spread(): the most pixels that a unit of standard deviation covers at depth 1. */
export function spreads(camera) {
  if (camera.orthographic) return [Math.abs(camera.fx), Math.abs(camera.fy)];
  const [left, right, low, high] = tangentLimits(camera).map(Math.abs);
  return [Math.abs(camera.fx) * Math.hypot(1, Math.max(left, right)), Math.abs(camera.fy) * Math.hypot(1, Math.max(low, high))];
}

/**
 * What tables.js and order.js need of an instance before a camera.
 *
 * instance  {model, place, t, look, crops, backdrop, sampling}, see Scene.at(); kinds: of its model
 * toCamera  from the world to the camera
 */
export function viewed(instance, kinds, camera, toCamera) {
  const rows = multiplied(toCamera, instance.place), toModel = inverse(rows);
  const scale = Math.cbrt(Math.abs(determinant(instance.place))), { sampling, backdrop } = instance;
  const known = sampling && scale > 0;
  const pixel = known ? 1 / (Math.sqrt(Math.abs(camera.fx * camera.fy)) * scale) : 0;
  const inRange = rows.every((value) => Math.abs(value) <= LIMIT);
  return {
    ...instance, kinds, rows, toModel, near: Math.max(camera.near || 0, kinds.raster.near * scale),
    far: inRange ? Math.min(camera.far ?? LIMIT, LIMIT) : -1, stretch: stretch(rows),
    ball: ball(kinds.backdrop, backdrop, toModel), sampling: { ...(known ? sampling : OFF), pixel },
  };
}

const OFF = { ball: [0, 0, 0, 0], coarse: 0, least: 0, reach: 0, fades: false, cameras: [] };

/** ViewedInstance.ball: in which a Gaussian must rest to be drawn. */
function ball(backdrop, shown, toModel) {
  const inside = () => Math.hypot(...backdrop.centre.map((x, k) => x - toModel[4 * k + 3])) / backdrop.radius < WITHIN;
  if (!backdrop || shown === "SHOWN" || (shown === "INSIDE" && inside())) return [0, 0, 0, Infinity];
  return [...backdrop.centre, backdrop.radius ** 2];
}
