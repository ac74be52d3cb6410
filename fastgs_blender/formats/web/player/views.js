// SPDX-License-Identifier: GPL-3.0-or-later
/** Instances before a camera: rendering/instances.py (ViewedInstance) and cameras/camera.py. */
import { LIBRARY } from "./library.js";
import { determinant, inverse, multiplied, stretch } from "./matrices.js";

const { LENS, LIMIT, WITHIN } = LIBRARY.view;

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
  const focal = Math.sqrt(Math.abs(camera.fx * camera.fy)), pixel = known ? 1 / (focal * scale) : 0;
  const zoom = known && !camera.orthographic ? zoomAt(sampling, [3, 7, 11].map((k) => toModel[k]), focal) : 1;
  const inRange = rows.every((value) => Math.abs(value) <= LIMIT);
  return {
    ...instance, kinds, rows, toModel, near: Math.max(camera.near || 0, kinds.raster.near * scale),
    far: inRange ? Math.min(camera.far ?? LIMIT, LIMIT) : -1, stretch: stretch(rows),
    ball: ball(kinds.backdrop, backdrop, toModel), sampling: { ...(known ? sampling : OFF), pixel, zoom },
  };
}

/** Sampling.zoom_at(). */
function zoomAt({ ball, cameras }, place, focal) {
  let sum = 0, weights = 0;
  for (const camera of cameras) {
    const away = (Math.hypot(...place.map((x, k) => camera[k] - x)) / Math.max(ball[3], 1e-12)) ** 2;
    const weight = Math.max(away + LENS * Math.log(focal * camera[3]) ** 2, 1e-12) ** -2;
    sum += weight * focal * camera[3];
    weights += weight;
  }
  return weights > 0 ? sum / weights : 1;
}

const OFF = { ball: [0, 0, 0, 0], coarse: 0, least: 0, reach: 0, cameras: [] };

/** ViewedInstance.ball: in which a Gaussian must rest to be drawn. */
function ball(backdrop, shown, toModel) {
  const inside = () => Math.hypot(...backdrop.centre.map((x, k) => x - toModel[4 * k + 3])) / backdrop.radius < WITHIN;
  if (!backdrop || shown === "SHOWN" || (shown === "INSIDE" && inside())) return [0, 0, 0, Infinity];
  return [...backdrop.centre, backdrop.radius ** 2];
}
