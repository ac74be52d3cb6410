// SPDX-License-Identifier: GPL-3.0-or-later
/** Unpacks columns of whole numbers, as formats/columns.py packs them; that module says how they lie. */
import { checksum } from "./checksum.js";
import { damaged } from "./errors.js";
import { LIBRARY } from "./library.js";
import { isCount } from "./tensors.js";

const { DIRECT, FIRST, LAST, MOST, MOST_VALUES } = LIBRARY.columns;

/** The orders of a segment's Gaussians by columns that are known already: columns.Order. */
export class Order {
  constructor(count) {
    this.columns = new Map();
    this.orders = new Map();
    this.before = new Uint8Array(count);
    this.together = new Uint8Array(count);
  }

  /** Numbers around a centre have become known; null: another array begins. */
  follow(codes, centre) {
    for (const name of ["before", "together"]) {
      this.orders.delete(name);
      if (codes) this.columns.set(name, this[name]);
      else this.columns.delete(name);
    }
    const { before, together } = this;
    if (!codes) together.fill(0);
    else for (let n = 0; n < codes.length; n++) {
      before[n] = 32 - Math.clz32(Math.fround(Math.abs(codes[n] - centre)));
      together[n] = Math.min(together[n] + before[n], MOST_VALUES - 1);
    }
  }

  /** Indices that sort the Gaussians by a column; equal ones stay in their order. */
  by(name) {
    let order = this.orders.get(name);
    if (!order) {
      const column = this.columns.get(name), count = column.length;
      let low = Infinity, high = -Infinity;
      for (let n = 0; n < count; n++) {
        low = Math.min(low, column[n]);
        high = Math.max(high, column[n]);
      }
      const starts = new Uint32Array(count ? Math.min(high - low, 65535) + 2 : 1);
      for (let n = 0; n < count; n++) starts[Math.min(column[n] - low, 65535) + 1]++;
      for (let k = 1; k < starts.length; k++) starts[k] += starts[k - 1];
      order = new Uint32Array(count);
      for (let n = 0; n < count; n++) order[starts[Math.min(column[n] - low, 65535)]++] = n;
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
export async function unpacked(data, { name, crc, centre, mapped, context }, count, order) {
  if (checksum(data) !== crc) throw damaged(`the checksum of the column ${name} is another`);
  const raw = await expanded(data, 5 * count + 64, name);
  let at = 0;
  const take = (size) => {
    if (size > raw.length - at) throw damaged(`the column ${name} is cut short`);
    at += size;
    return raw.subarray(at - size, at);
  };
  const numbers = mapped ? scattered(take((count + 7) >> 3), count, take) : Uint32Array.from(take(count));
  const sizes = new Uint32Array(LAST - FIRST + 1);
  for (let n = 0; n < count; n++) if (numbers[n] >= DIRECT) sizes[(numbers[n] - DIRECT) >> 2]++;
  const places = Array.from(sizes, (size) => new Uint32Array(size)), ends = new Uint32Array(sizes.length);
  for (let n = 0; n < count; n++) {
    const symbol = numbers[n] - DIRECT, power = symbol >> 2;
    if (symbol < 0) continue;
    numbers[n] = ((symbol & 3) | 4) << (power + FIRST - 2);
    if (power < places.length) places[power][ends[power]++] = n;
  }
  places.forEach((own, power) => {
    const bits = power + FIRST - 2, packed = take((own.length * bits + 7) >> 3);
    for (let k = 0, n = 0; k < bits; k++) for (let i = 0; i < own.length; i++) numbers[own[i]] |= bit(packed, n++) << k;
  });
  if (at !== raw.length) throw damaged(`the column ${name} is longer than its Gaussians need`);
  const out = new Int32Array(count), index = context ? order.by(context) : null;
  for (let n = 0; n < count; n++) out[index ? index[n] : n] = ((numbers[n] >>> 1) ^ -(numbers[n] & 1)) + centre;
  return out;
}

/** The symbols of the numbers that a map shows; the others are 0. */
function scattered(map, count, take) {
  let shown = 0, at = 0;
  for (let n = 0; n < count; n++) shown += bit(map, n);
  const listed = take(shown), symbols = new Uint32Array(count);
  for (let n = 0; n < count; n++) if (bit(map, n)) symbols[n] = listed[at++];
  return symbols;
}

function bit(bytes, n) {
  return (bytes[n >> 3] >> (7 - (n & 7))) & 1;
}

/** The content of a zlib stream, of at most `most` bytes: no more is unpacked. */
async function expanded(data, most, name) {
  const reader = new Blob([data]).stream().pipeThrough(new DecompressionStream("deflate")).getReader(), raw = new Uint8Array(most);
  let size = 0;
  try {
    for (let step; !(step = await reader.read()).done; size += step.value.length) raw.set(step.value, size); // throws beyond the end
  } catch {
    reader.cancel().catch(() => {});
    throw damaged(`the column ${name} cannot be unpacked, or is longer than its Gaussians need`);
  }
  return raw.subarray(0, size);
}
