// SPDX-License-Identifier: GPL-3.0-or-later
/** Safetensors files in memory; every claim of the header is checked, as util/tensor_files.py does. */
import { damaged } from "./errors.js";

const SIZES = { U8: 1, F32: 4 };

export class TensorFile {
  constructor(bytes) {
    this.bytes = bytes;
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    const size = bytes.length < 8 ? 0 : view.getUint32(0, true) + 2 ** 32 * view.getUint32(4, true);
    if (!(size >= 2 && size <= bytes.length - 8)) throw damaged("its model is cut short");
    let table;
    try {
      table = JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(bytes.subarray(8, 8 + size)));
    } catch {
      throw damaged("the header of its model cannot be read");
    }
    if (!isTable(table)) throw damaged("the header of its model is no table");
    this.metadata = isTable(table.__metadata__) ? table.__metadata__ : {};
    this.entries = new Map();
    for (const [name, about] of Object.entries(table)) {
      if (name !== "__metadata__") this.entries.set(name, entry(name, about, 8 + size, bytes.length));
    }
  }

  /** The bytes of an array of that type; shape: what it must be, null for any list. */
  read(name, dtype, shape) {
    const found = this.entries.get(name);
    const fits = found && found.dtype === dtype && (shape ? `${found.shape}` === `${shape}` : found.shape.length === 1);
    if (!fits) throw damaged(`its array ${name} is missing or of another size`);
    return this.bytes.subarray(found.begin, found.end);
  }

  /** A Float32Array of its own of an array of that shape. */
  floats(name, shape) {
    return new Float32Array(this.read(name, "F32", shape).slice().buffer);
  }
}

export function isTable(value) {
  return typeof value === "object" && value !== null && !Array.isArray(value);
}

export function isCount(value, most = 2 ** 53) {
  return Number.isInteger(value) && value >= 0 && value <= most;
}

function entry(name, about, begin, length) {
  const { dtype, shape, data_offsets: span } = isTable(about) ? about : {};
  const lists = Array.isArray(shape) && shape.length <= 32 && Array.isArray(span) && span.length === 2;
  if (!lists || ![...shape, ...span].every((n) => isCount(n))) throw damaged(`its header does not say what the array ${name} is`);
  const size = SIZES[dtype] * shape.reduce((product, n) => product * n, 1);
  if (span[1] - span[0] !== size || begin + span[1] > length) throw damaged(`its array ${name} is cut short`);
  return { dtype, shape, begin: begin + span[0], end: begin + span[1] };
}
