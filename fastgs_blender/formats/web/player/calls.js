// SPDX-License-Identifier: GPL-3.0-or-later
/** Calls what a worker does, by the text of its script. */
import { PageError } from "./errors.js";

export class Calls {
  constructor(text) {
    const address = URL.createObjectURL(new Blob([text], { type: "text/javascript" }));
    this.waiting = new Map();
    this.number = 0;
    try {
      this.worker = new Worker(address);
    } catch {
      throw new PageError("This browser lets a page do nothing in the background, which this one needs. Try another browser.");
    }
    this.worker.onmessage = ({ data }) => {
      URL.revokeObjectURL(address);
      const { resolve, reject, progress } = this.waiting.get(data.number);
      if (data.progress !== undefined) return progress(data.progress);
      this.waiting.delete(data.number);
      if (data.failed) reject(new PageError(data.failed));
      else resolve(data.answer);
    };
    this.worker.onerror = (event) => {
      event.preventDefault();
      this.fail(new PageError("What this page does in the background has stopped. Load it again, or export it smaller."));
    };
  }

  /** The promise of an answer; transfer: buffers that go over. */
  call(name, given = {}, transfer = [], progress = () => {}) {
    const number = this.number++;
    return new Promise((resolve, reject) => {
      if (!this.worker) return reject(this.reason);
      this.waiting.set(number, { resolve, reject, progress });
      this.worker.postMessage({ number, name, given }, transfer);
    });
  }

  fail(reason) {
    if (this.worker) this.worker.terminate();
    this.worker = null;
    this.reason = reason;
    for (const { reject } of this.waiting.values()) reject(reason);
    this.waiting.clear();
  }
}
