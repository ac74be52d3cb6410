// SPDX-License-Identifier: GPL-3.0-or-later
/** What a page does beside its main thread: it holds the models, makes their texels, and sorts.  model_worker.js lets others call it. */
import { readModel } from "./model.js";
import { Sorter, prepared } from "./order.js";
import { layoutOf, rowCount, rowsOf } from "./texels.js";

export class Service {
  constructor() {
    this.models = [];
    this.sorter = new Sorter();
  }

  /** Reads the files of models, by their numbers; returns what is to be known of each: its kinds, how many Gaussians it has, and where most of them are. */
  async open({ numbers, files }, progress) {
    const total = files.reduce((sum, { length }) => sum + length, 0), found = [];
    let done = 0;
    for (const [k, file] of files.entries()) {
      const model = await readModel(file, (share) => progress((done + share * file.length) / total)), { count, kinds, arrays } = model;
      this.models[numbers[k]] = { ...model, ...prepared(model) };
      done += file.length;
      found.push({ count, kinds: plain(kinds), span: span(arrays.position) });
    }
    return found;
  }

  /** Forgets models. */
  drop({ numbers }) {
    for (const number of numbers) delete this.models[number];
  }

  /** Begins to give the texels of models, of textures that are `width` wide, and says how many rows each of them takes. */
  texels({ numbers, width, rows }) {
    const kinds = ["geometry", "colour"];
    this.pieces = (function* (models) {
      for (const model of numbers) {
        for (const kind of kinds) for (const piece of rowsOf(models[model], kind, width, rows)) yield { model, kind, ...piece };
      }
    })(this.models);
    return numbers.map((number) => ({
      layout: layoutOf(this.models[number].kinds), ...Object.fromEntries(kinds.map((kind) => [kind, rowCount(this.models[number], kind, width)])),
    }));
  }

  /** The next piece of the texels; null: that was all.  One at a time, so that no more memory is held. */
  piece() {
    return this.pieces.next().value || null;
  }

  order(view) {
    return this.sorter.order(view, this.models);
  }
}

/** Kinds as threads may send them: bases are made again of what they were made of. */
function plain(kinds) {
  return Object.fromEntries(Object.entries(kinds).map(([name, value]) => [name, value && value.made ? { made: value.made } : value]));
}

/** Low and high of the places of all but the outermost twentieths, by axis. */
function span(position) {
  const step = 3 * Math.max(Math.ceil(position.length / 3 / 20000), 1), axes = [0, 1, 2].map((axis) => {
    const values = [];
    for (let n = axis; n < position.length; n += step) if (Number.isFinite(position[n])) values.push(position[n]);
    return values.sort((a, b) => a - b);
  });
  const at = (share) => axes.map((values) => values[Math.floor(share * (values.length - 1))] ?? 0);
  return { low: at(0.05), high: at(0.95) };
}
