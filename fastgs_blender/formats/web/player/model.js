// SPDX-License-Identifier: GPL-3.0-or-later
/** Reads a model from our own file: formats/native.py and formats/compressed.py.  Counts are checked before anything is allocated. */
import { basis } from "./bases.js";
import { Order, block, unpacked } from "./columns.js";
import { damaged } from "./errors.js";
import { LIBRARY } from "./library.js";
import { Steps, restore, shapes } from "./quantising.js";
import { TensorFile, isCount, isTable } from "./tensors.js";

const { COMPRESSED, FEWEST_BYTES, SEGMENT, SMALL, VERSION } = LIBRARY.files;
const { ACTIVATIONS, APPEARANCES, DECODER, DECODES, TEMPORAL } = LIBRARY.kinds;
const MOST_NUMBERS = 2 ** 28; // of a model, a GiB of them: equal numbers take next to nothing in a file

/** {count, kinds, arrays} of a file's bytes; progress is called with 0..1. */
export async function readModel(bytes, progress) {
  const file = new TensorFile(bytes), about = described(file.metadata["fast-gs"]);
  const kinds = kindsOf(about.model, file);
  if (about.version === COMPRESSED) return { kinds, ...(await compressed(file, about.compressed, kinds, progress)) };
  const entry = file.entries.get("position"), count = entry ? entry.shape[0] : 0;
  const arrays = {};
  for (const [name, shape] of Object.entries(arrayShapes(kinds, count))) {
    arrays[name] = shape.slice(1).includes(0) ? new Float32Array(0) : file.floats(name, shape);
  }
  return { kinds, count, arrays };
}

function described(text) {
  let about = null;
  try {
    about = JSON.parse(text);
  } catch {} // said below
  if (!isTable(about) || ![VERSION, COMPRESSED].includes(about.version)) throw damaged("its model is of no version that it can play");
  return about;
}

/** What the columns of a model's arrays mean. */
function kindsOf(about, file) {
  const { temporal, appearance: look, raster, clip, colour_space: space } = isTable(about) ? about : {};
  const good = Object.hasOwn(TEMPORAL, temporal) && isTable(look) && Object.hasOwn(APPEARANCES, look.name) && isTable(raster)
    && ["blur", "alpha_max", "alpha_cut", "near"].every((name) => raster[name] >= 0 && raster[name] <= 1e30)
    && isTable(clip) && isCount(clip.frame_count, 1e7) && clip.frame_count > 0 && ["srgb", "linear"].includes(space);
  if (!good) throw damaged("its header does not say what its numbers mean");
  const moment = look.name === "changing" ? look.look : look;
  const plain = isTable(moment) && (moment === look || ["rgb", "sh"].includes(moment.name));
  const degree = plain && moment.name === "sh" ? moment.degree : 0;
  if (!plain || !isCount(degree, 4)) throw damaged("the colours of its model are of no known kind");
  const [motion, turning, changing] = [about.basis, about.rotation_basis, moment === look ? { name: "static" } : look.basis].map(basis);
  const own = moment.name === "features" ? 9 : 3 * (degree + 1) ** 2;
  return {
    motion, turning, changing, terms: motion.terms, turns: turning.terms, ...TEMPORAL[temporal], raster, degree, space,
    frames: clip.frame_count, appearance: APPEARANCES[moment.name], own, width: own * (1 + changing.terms),
    decoder: moment.name === "features" ? decoder(moment, file) : null, backdrop: backdrop(about.surroundings),
  };
}

function backdrop(around) {
  const { centre, radius } = (isTable(around) && around.backdrop) || {};
  if (centre === undefined) return null;
  const good = Array.isArray(centre) && centre.length === 3 && [...centre, radius].every(Number.isFinite) && radius > 0;
  if (!good) throw damaged("the backdrop of its model has no place");
  return { centre, radius };
}

function decoder({ activation, decode = DECODES[0] }, file) {
  const found = { activation: ACTIVATIONS.indexOf(activation), decode: DECODES.indexOf(decode) };
  if (found.activation < 0 || found.decode < 0) throw damaged("the decoder of its colours is of no known kind");
  for (const [name, shape] of Object.entries(DECODER)) found[name] = file.floats(`decoder.${name}`, shape);
  return found;
}

function arrayShapes({ terms, turns, logarithms, width }, n) {
  return { position: [n, 3], rotation: [n, 4], scale: [n, 3], opacity: [n], features: [n, width], motion: [n, terms, 3],
           rotation_motion: [n, turns, 4], mu_tau: [n], temporal: [n, logarithms.length] };
}

async function compressed(file, about, kinds, progress) {
  const { count: counts, steps, blocks } = isTable(about) ? about : {};
  const lists = [counts, steps, blocks].every((list) => Array.isArray(list) && list.length === counts.length);
  if (!lists) throw damaged("its header does not say which segments its model has");
  const parts = counts.map((count, i) => {
    const data = file.read(`segment.${i}`, "U8");
    if (!isCount(count, Math.min(SEGMENT, SMALL + data.length / FEWEST_BYTES))) throw damaged(`its segment ${i} is too short`);
    return { data, count, steps: new Steps(steps[i], kinds), blocks: blocks[i] };
  });
  const total = counts.reduce((sum, count) => sum + count, 0);
  const sizes = Object.entries(arrayShapes(kinds, total)).map(([name, shape]) => [name, shape.reduce((product, n) => product * n, 1)]);
  if (sizes.reduce((sum, [, size]) => sum + size, 0) > MOST_NUMBERS) throw new RangeError();
  const arrays = Object.fromEntries(sizes.map(([name, size]) => [name, new Float32Array(size)]));
  let first = 0;
  for (const part of parts) {
    restore(await columnsOf(part, kinds), part.steps, kinds, arrays, first);
    first += part.count;
    progress(first / total);
  }
  return { count: total, arrays };
}

/** The columns of a segment by name: compressed.columns_of(). */
async function columnsOf({ data, count, steps, blocks }, kinds) {
  const four = kinds.turns && !kinds.turning.centred;
  const widths = { shape: 1, tint: 1, life: 1, scale: 3, opacity: 1, features: kinds.width, mu_tau: 1, motion: 3 * kinds.terms, position: 3,
                   rotation_motion: 4 * kinds.turns, rotation: four ? 4 : 3 };
  kinds.logarithms.forEach((logarithm, k) => {
    for (const part of logarithm ? [""] : [".high", ".low"]) widths[`temporal.${k}${part}`] = 1;
  });
  const names = Object.keys(widths), order = new Order(count), codes = {};
  if (!Array.isArray(blocks) || blocks.length !== names.reduce((sum, name) => sum + widths[name], 0)) {
    throw damaged("a segment of its model has other columns than it should");
  }
  let at = 0, listed = 0;
  for (const name of names) {
    codes[name] = [];
    order.follow(null);
    for (let k = 0; k < widths[name]; k++) {
      const about = block(blocks[listed++], `${name}/${k}`, order);
      if (about.size > data.length - at) throw damaged(`the column ${name}/${k} is cut short`);
      const column = await unpacked(data.subarray(at, at + about.size), about, count, order);
      codes[name].push(column);
      order.follow(column, about.centre);
      at += about.size;
    }
    const known = name === "scale" ? shapes(codes, steps) : ["shape", "tint", "life"].includes(name) ? { [name]: codes[name][0] } : {};
    for (const [context, column] of Object.entries(known)) order.columns.set(context, column);
  }
  return codes;
}
