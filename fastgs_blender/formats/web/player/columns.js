// SPDX-License-Identifier: GPL-3.0-or-later
/** Unpacks columns of whole numbers, as formats/columns.py packs them; that module says how they lie. */
import { damaged } from "./errors.js";
import { LIBRARY } from "./library.js";
import { isCount } from "./tensors.js";
import { decompress } from "./vendored/fzstd.js";

const { DIRECT, FIRST, LAST, MOST, MOST_VALUES } = LIBRARY.columns;
const CRC = Uint32Array.from({ length: 256 }, (_, n) => {
  for (let k = 0; k < 8; k++) n = n & 1 ? (n >>> 1) ^ 0xedb88320 : n >>> 1;
  return n >>> 0;
});

/** The orders of a segment's Gaussians by columns that are known already: columns.Order. */
export class Order {
  constructor() {
    this.columns = new Map();
    this.orders = new Map();
  }

  /** Numbers around a centre have become known; null: another array begins. */
  follow(codes, centre) {
    const before = this.columns.get("together");
    for (const name of ["before", "together"]) {
      this.orders.delete(name);
      this.columns.delete(name);
    }
    if (!codes) return;
    const length = new Int32Array(codes.length), together = new Int32Array(codes.length);
    for (let n = 0; n < codes.length; n++) {
      length[n] = 32 - Math.clz32(Math.fround(Math.abs(codes[n] - centre)));
      together[n] = Math.min((before ? before[n] : 0) + length[n], MOST_VALUES - 1);
    }
    this.columns.set("before", length);
    this.columns.set("together", together);
  }

  /** Indices that sort the Gaussians by a column; equal ones stay in their order. */
  by(name) {
    let order = this.orders.get(name);
    if (!order) {
      const column = this.columns.get(name);
      let low = Infinity, high = -Infinity;
      for (const value of column) {
        if (value < low) low = value;
        if (value > high) high = value;
      }
      const starts = new Uint32Array(column.length ? Math.min(high - low, 65535) + 2 : 1);
      for (const value of column) starts[Math.min(value - low, 65535) + 1]++;
      for (let k = 1; k < starts.length; k++) starts[k] += starts[k - 1];
      order = new Uint32Array(column.length);
      for (let n = 0; n < column.length; n++) order[starts[Math.min(column[n] - low, 65535)]++] = n;
      this.orders.set(name, order);
    }
    return order;
  }
}

/** What a header says of a packed column, checked: columns.Block. */
export function block(listed, name, order) {
  const [own, size, crc, centre, mapped, context] = Array.isArray(listed) && listed.length === 6 ? listed : [];
  const good = own === name && isCount(size, 2 ** 40) && isCount(crc) && Number.isInteger(centre) && Math.abs(centre) <= MOST;
  if (!good || !(mapped === 0 || mapped === 1) || !(context === "" || order.columns.has(context))) {
    throw damaged(`its header does not say how the column ${name} is packed`);
  }
  return { name, size, crc, centre, mapped, context };
}

/** The whole numbers of a packed column, an Int32Array of `count`. */
export function unpacked(data, { name, crc, centre, mapped, context }, count, order) {
  if (checksum(data) !== crc) throw damaged(`the checksum of the column ${name} is another`);
  const raw = expanded(data, 5 * count + 64, name);
  let at = 0;
  const take = (size) => {
    if (size > raw.length - at) throw damaged(`the column ${name} is cut short`);
    at += size;
    return raw.subarray(at - size, at);
  };
  let symbols = mapped ? new Uint8Array(count) : take(count);
  if (mapped) {
    const map = take((count + 7) >> 3);
    let shown = 0;
    for (let n = 0; n < count; n++) shown += bit(map, n);
    const listed = take(shown);
    for (let n = 0, k = 0; n < count; n++) if (bit(map, n)) symbols[n] = listed[k++];
  }
  const numbers = new Uint32Array(symbols), beyond = Array.from({ length: LAST - FIRST + 1 }, () => []);
  for (let n = 0; n < count; n++) {
    if (symbols[n] < DIRECT) continue;
    const power = (symbols[n] - DIRECT) >> 2;
    numbers[n] = (((symbols[n] - DIRECT) & 3) | 4) << (power + FIRST - 2);
    if (beyond[power]) beyond[power].push(n);
  }
  beyond.forEach((places, power) => {
    const bits = power + FIRST - 2, packed = take((places.length * bits + 7) >> 3);
    for (let k = 0, n = 0; k < bits; k++) for (const place of places) numbers[place] |= bit(packed, n++) << k;
  });
  if (at !== raw.length) throw damaged(`the column ${name} is longer than its Gaussians need`);
  const out = new Int32Array(count), index = context ? order.by(context) : null;
  for (let n = 0; n < count; n++) out[index ? index[n] : n] = ((numbers[n] >>> 1) ^ -(numbers[n] & 1)) + centre;
  return out;
}

function bit(bytes, n) {
  return (bytes[n >> 3] >> (7 - (n & 7))) & 1;
}

function checksum(data) {
  let crc = -1;
  for (let n = 0; n < data.length; n++) crc = CRC[(crc ^ data[n]) & 255] ^ (crc >>> 8);
  return ~crc >>> 0;
}

/** The content of a zstd frame that says its own length, of at most `most` bytes: nothing is allocated on its word alone. */
function expanded(data, most, name) {
  const flags = data[4], single = (flags >> 5) & 1, width = [single, 2, 4, 8][flags >> 6];
  let size = width === 2 ? 256 : 0, at = 6 - single + [0, 1, 2, 4][flags & 3];
  for (let k = 0; k < width; k++) size += data[at + k] * 2 ** (8 * k);
  if (!width || !(size <= most)) throw damaged(`the column ${name} would be longer than its Gaussians need`);
  try {
    const out = size ? decompress(data) : new Uint8Array(0);
    if (out.length === size) return out;
  } catch {} // what the package says of damage is in its own words
  throw damaged(`the column ${name} cannot be unpacked`);
}
