// SPDX-License-Identifier: GPL-3.0-or-later
// Reads a file with @sparkjsdev/spark, outside of a browser: node spark.mjs FOLDER_OF_NODE_MODULES FILE OUT
// OUT: for each Gaussian 14 float32: x y z, scales, quaternion x y z w, opacity, colour r g b.
import { resolveObjectURL } from "node:buffer";
import { readFileSync, writeFileSync } from "node:fs";
import { pathToFileURL } from "node:url";
import { Worker as Thread } from "node:worker_threads";

// what a browser's worker has and a thread of Node's lacks
const AS_IN_A_BROWSER = `
const { parentPort } = require("node:worker_threads");
globalThis.self = globalThis;
const list = (t) => (Array.isArray(t) ? t : t?.transfer ?? []);
globalThis.postMessage = (m, t) => parentPort.postMessage(m, list(t));
const handlers = [];
globalThis.addEventListener = (kind, f) => { if (kind === "message") handlers.push(f); };
globalThis.removeEventListener = () => {};
parentPort.on("message", (data) => { handlers.forEach((f) => f({ data })); globalThis.onmessage?.({ data }); });
`;

globalThis.Worker = class {
  constructor(url) {
    this.queue = [];
    this.listeners = [];
    this.begin(String(url));
  }

  async begin(url) {
    const text = url.startsWith("blob:") ? await resolveObjectURL(url).text() : await (await fetch(url)).text();
    this.thread = new Thread(AS_IN_A_BROWSER + text, { eval: true });
    this.thread.on("message", (data) => {
      this.onmessage?.({ data });
      this.listeners.forEach((f) => f({ data }));
    });
    this.queue.forEach(([message, transfer]) => this.thread.postMessage(message, transfer));
    this.queue = null;
  }

  addEventListener(kind, f) {
    if (kind === "message") this.listeners.push(f);
  }

  removeEventListener() {}

  postMessage(message, transfer) {
    const list = Array.isArray(transfer) ? transfer : transfer?.transfer ?? [];
    if (this.queue) this.queue.push([message, list]);
    else this.thread.postMessage(message, list);
  }

  terminate() {
    this.thread?.terminate();
  }
};

const [modules, file, out] = process.argv.slice(2);
const { ExtSplats } = await import(pathToFileURL(`${modules}/@sparkjsdev/spark/dist/spark.module.js`).href);
const splats = new ExtSplats({ fileBytes: new Uint8Array(readFileSync(file)), fileName: file });
await splats.initialized;
const rows = new Float32Array(14 * splats.numSplats);
splats.forEachSplat((i, place, size, turn, opacity, colour) => {
  rows.set([...place.toArray(), ...size.toArray(), turn.x, turn.y, turn.z, turn.w, opacity, colour.r, colour.g, colour.b], 14 * i);
});
writeFileSync(out, rows);
process.exit(0);
