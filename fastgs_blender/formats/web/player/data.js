// SPDX-License-Identifier: GPL-3.0-or-later
/** What lies in a page's file: the description, and models and sound as base64, which arrive after the script. */
import { checksum } from "./checksum.js";
import { damaged } from "./errors.js";

const CUT = "a part of it is missing at its end";

/** Resolves once f() gives something, or the whole file is there; f() is asked again while it arrives. */
async function awaited(f) {
  for (;;) {
    const complete = document.readyState !== "loading", found = f();
    if (found || complete) return found;
    await new Promise((done) => setTimeout(done, 50));
  }
}

/** The description: JSON is there as a whole, or not at all. */
export async function described() {
  await awaited(() => document.getElementById("model-0"));
  try {
    return JSON.parse(document.getElementById("scene").textContent);
  } catch {
    throw damaged("the description of its scene cannot be read");
  }
}

/** Waits for parts of the file; progress(0..1) is called meanwhile. */
export async function arrived({ parts }, names, progress = () => {}) {
  const all = names.reduce((sum, name) => sum + parts[name].bytes, 0);
  await awaited(() => {
    const found = names.map((name) => document.getElementById(name));
    progress(Math.min(found.reduce((sum, element) => sum + 0.75 * (element ? element.textContent.length : 0), 0) / (all || 1), 1));
    return found.every((element) => element && element.nextElementSibling); // what follows it says that it is whole
  });
}

/** The bytes of a part of the file, "model-0" or "sound", as the description counts and sums them up; again: they will be asked for once more. */
export function bytesOf({ parts }, name, again = false) {
  const element = document.getElementById(name), { bytes, crc } = parts[name];
  if (!element) throw damaged(CUT);
  const data = decoded(element.textContent.trim());
  if (!again) element.remove();
  if (!data || data.length !== bytes) throw damaged(CUT);
  if (checksum(data) !== crc) throw damaged(`${name} is not as it was exported`);
  return data;
}

/** The text of a worker; a damaged one would stop without saying why. */
export function workerText({ workers }, name) {
  const { textContent } = document.getElementById(name) || { textContent: "" };
  if (checksum(new TextEncoder().encode(textContent)) !== (workers || {})[name]) throw damaged("its player is not as it was exported");
  return textContent;
}

function decoded(text) {
  try {
    if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
    const letters = atob(text), data = new Uint8Array(letters.length);
    for (let i = 0; i < letters.length; i++) data[i] = letters.charCodeAt(i);
    return data;
  } catch {
    return null;
  }
}
