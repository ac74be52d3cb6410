// SPDX-License-Identifier: GPL-3.0-or-later
/**
 * A moment and a view as the end of an address: #t=1.2&view=x,y,z,yaw,pitch,distance,roll
 *
 *   t      seconds; the page opens there, paused
 *   view   the point in the middle, angles in degrees, the distance; a roll of 0 is left out
 *   play   1: plays by itself in a frame of another page too, as that page asks for it
 */
const MOST = 1e9;

/** {time, view, play} of an address's end; what is missing or makes no sense is null. */
export function parsed(hash) {
  const fields = new URLSearchParams(hash.replace(/^#/, ""));
  const time = number(fields.get("t")), parts = (fields.get("view") || "").split(",").map(number), good = (x) => x !== null;
  const [x, y, z, yaw, pitch, distance, roll = 0] = parts;
  const view = (parts.length === 6 || parts.length === 7) && parts.every(good) && distance > 0 && Math.abs(pitch) < 90
    ? { pivot: [x, y, z], yaw, pitch, roll, distance } : null;
  return { time: time !== null && time >= 0 ? time : null, view, play: fields.get("play") === "1" };
}

/** The end of an address; time: null where it is not to be said. */
export function written(time, view) {
  const { pivot, yaw, pitch, roll, distance } = view, short = (value) => Number(value.toPrecision(6)).toString();
  const angle = (value) => Number(value.toFixed(2)).toString(), tilt = angle(roll);
  const size = (value) => (Math.abs(value) < distance * 1e-6 ? "0" : short(value));
  const place = [...pivot.map(size), angle(yaw), angle(pitch), short(distance), ...(Number(tilt) ? [tilt] : [])].join(",");
  return `#${time === null ? "" : `t=${Number(time.toFixed(3))}&`}view=${place}`;
}

function number(text) {
  const value = text === null || text.trim() === "" ? NaN : Number(text);
  return Number.isFinite(value) && Math.abs(value) <= MOST ? value : null;
}
