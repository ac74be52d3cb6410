// SPDX-License-Identifier: GPL-3.0-or-later
/** Draws a scene as Blender's viewports do (engine/viewport/picture.py and view.py), with the last order that the worker has sent. */
import { PageError } from "./errors.js";
import { Graphics } from "./gl.js";
import { LIBRARY } from "./library.js";
import { inverse } from "./matrices.js";
import { frameTable, grouped, resolveTable } from "./tables.js";
import { spreads, viewed } from "./views.js";

const { WIDTH, ORDER_WIDTH } = LIBRARY.textures;
const PIECE = 64; // rows of texels that are sent at a time
const AROUND = 1 / 8; // of a picture's longer side: orders reach so far beyond its edges, for the view moves on before the next one comes

/** The first row of a free run of rows of an atlas for each of `wanted`; null where not all of them fit. */
function room({ places, rows }, kind, wanted) {
  const taken = Object.values(places).map((place) => [place[kind] / place.width, place.rows[kind]]).sort(([a], [b]) => a - b), found = [];
  for (const length of wanted) {
    let at = 0, k = 0;
    while (k < taken.length && taken[k][0] - at < length) [at, k] = [taken[k][0] + taken[k][1], k + 1];
    if (at + length > rows[kind]) return null;
    found.push(at);
    taken.splice(k, 0, [at, length]);
  }
  return found;
}

export class Renderer {
  /** Throws PageError where the browser cannot draw it.  onfresh is called when a picture has become better than the last draw(). */
  constructor(canvas, scene, onfresh = () => {}) {
    Object.assign(this, { canvas, scene, onfresh });
    this.build();
  }

  /** Makes everything that is on the GPU; again after a lost context. */
  build() {
    this.graphics = new Graphics(this.canvas);
    Object.assign(this, { last: null, targets: [], shape: "", order: null, arrived: "", list: null, work: null, failure: null,
                          atlas: null, shown: new Set(), reading: null, table: null, resolved: null, linear: null, sum: null, nothing: null });
    this.loading = this.load([...this.scene.models.keys()].filter((number) => this.scene.models[number]));
    this.loading.catch((error) => (this.failure = error));
  }

  restore() {
    const { last } = this;
    this.build();
    if (last) this.draw(last.camera, last.frame);
    return this.settled();
  }

  dispose() {
    this.scene.calls.fail(new PageError("The page has been closed."));
    const lose = this.graphics.gl.getExtension("WEBGL_lose_context");
    if (lose) lose.loseContext();
  }

  /** Sends models, by their numbers, to the GPU: into free rows of the textures, or with all that are there into new ones. */
  async load(numbers) {
    const { graphics, scene } = this, width = Math.min(WIDTH, graphics.largest), kinds = ["geometry", "colour"];
    const models = await scene.calls.call("texels", { numbers, width, rows: PIECE });
    const before = this.atlas, fits = before && kinds.every((kind) => room(before, kind, models.map((model) => model[kind])));
    const all = [...scene.models.keys()].filter((number) => scene.models[number]);
    if (before && !fits && numbers.length < all.length) return this.load(all);
    if (!graphics.float && (numbers.length > 1 || numbers.some((number) => scene.models[number].kinds.decoder || scene.models[number].kinds.space === "linear"))) {
      throw new PageError("This device's graphics cannot add up the colours of this page (EXT_color_buffer_float). Open it on another one.");
    }
    const atlas = fits ? before : this.made(width, kinds.map((kind) => models.reduce((sum, model) => sum + model[kind], 0))), places = {};
    const first = kinds.map((kind) => room(atlas, kind, models.map((model) => model[kind])));
    models.forEach(({ layout, geometry, colour }, k) => {
      const number = numbers[k], begins = first.map((rows) => rows[k]);
      places[number] = { layout, width, geometry: begins[0] * width, colour: begins[1] * width, rows: { geometry, colour } };
    });
    for (let piece; (piece = await scene.calls.call("piece"));) {
      const { model, kind, row, texels } = piece;
      if (graphics !== this.graphics) return; // the context was lost meanwhile
      graphics.send(atlas.textures[kind], places[model][kind] / width + row, texels.length / (4 * width), 4, texels);
    }
    Object.assign(atlas.places, places);
    if (before && !fits) for (const texture of Object.values(before.textures)) graphics.gl.deleteTexture(texture);
    this.atlas = atlas;
    if (this.last) this.ask();
  }

  /** An atlas without models, with so many rows of geometry and colour; with as many again where others will come. */
  made(width, needed) {
    const { graphics, scene } = this, spare = scene.objects.some(({ shown }) => shown) ? 2.5 : 1;
    if (Math.max(...needed) > graphics.largest) {
      throw new PageError("This device's graphics have no room for so many Gaussians. Open the page on another one, or export it smaller.");
    }
    const [geometry, colour] = needed.map((rows) => Math.min(Math.max(Math.ceil(spare * rows), 1), graphics.largest));
    return { width, places: {}, rows: { geometry, colour },
             textures: { geometry: graphics.texture("RGBA32F", width, geometry), colour: graphics.texture("RGBA16F", width, colour) },
             depth: graphics.table(null, { data: new Float32Array(4).fill(1), width: 1, height: 1 }) };
  }

  /** Reads the models that the frame of the last draw() shows, and then those that come next; of others, the chapter before stays. */
  follow() {
    const { scene, last } = this;
    if (this.reading || !last || !this.atlas) return;
    const [now, next] = scene.wanted(last.frame), missing = [now, next].map((list) => list.filter((number) => !scene.models[number])).find((list) => list.length);
    if (`${now}` !== `${scene.now || ""}`) [scene.before, scene.now] = [scene.now || [], now];
    if (!missing) return;
    const keep = new Set([...now, ...next, ...scene.before, ...this.shown]), gone = Object.keys(this.atlas.places).map(Number).filter((number) => !keep.has(number));
    this.reading = (async () => {
      for (const number of gone) delete this.atlas.places[number];
      if (gone.length) await scene.drop(gone);
      await scene.read(missing);
      await this.load(missing);
      this.reading = null;
      this.onfresh();
    })();
    this.reading.catch((error) => (this.failure = error));
  }

  /**
   * Draws with the order that is known by now, and asks for the right one.
   *
   * camera  {pose: camera to world [16], fx, fy, cx, cy, width, height, orthographic, near, far}; frame: of the scene, any number
   */
  draw(camera, frame) {
    if (this.failure) throw this.failure;
    const toCamera = inverse(camera.pose);
    const drawn = this.scene.at(frame).filter(({ model }) => !this.atlas || this.atlas.places[model]);
    const views = drawn.map((instance) => viewed(instance, this.scene.models[instance.model].kinds, camera, toCamera));
    this.last = { camera: { ...camera, orthographic: Boolean(camera.orthographic) }, frame, views, key: JSON.stringify([camera, [...camera.pose], frame, drawn.map(({ model }) => model)]) };
    this.paint();
    this.follow();
    this.ask();
  }

  /** Resolves once the picture of the last draw() has its own order. */
  async settled() {
    await this.loading;
    while (this.last && (this.reading || this.arrived !== this.last.key)) {
      if (this.failure) throw this.failure;
      if (this.reading) {
        await this.reading;
        this.draw(this.last.camera, this.last.frame);
      }
      this.ask();
      await this.work;
    }
    if (this.last) this.paint();
  }

  /** Asks the worker for the order of the last draw(), unless it works: then that comes next, and what was between is left out. */
  ask() {
    const { last, graphics } = this;
    if (!this.atlas || !last || this.work || this.arrived === last.key) return;
    const { camera, key } = last, list = this.list, views = last.views.filter(({ there }) => there);
    this.list = null;
    const instances = views.map(({ model, first, t, look, rows, near, far, ball, crops, sampling, stretch }) =>
      ({ model, first, t, look, rows, near, far, ball, crops, stretch, sampling: { ...sampling, cameras: [] } }));
    const around = AROUND * Math.max(camera.width, camera.height);
    const given = { instances, camera: { ...camera, pose: null, spread: spreads(camera), around }, width: ORDER_WIDTH, list,
                    volumes: views.some(({ crops }) => crops.some(({ shape }) => shape === "VOLUME")) ? this.scene.volumes : [] };
    this.work = this.scene.calls.call("order", given, list ? [list.buffer] : []).then((order) => {
      if (graphics !== this.graphics) return;
      this.work = null;
      this.list = order.list;
      this.shown = new Set(views.map(({ model }) => model));
      this.take(order);
      this.arrived = key;
      this.ask();
      this.onfresh();
    });
    this.work.catch((error) => (this.failure = error));
  }

  /** Sends an order to the GPU. */
  take({ count, list, channels }) {
    const { graphics } = this, rows = Math.max(Math.ceil(count / ORDER_WIDTH), 1);
    if (!this.order || this.order.channels !== channels || this.order.room < rows) {
      if (this.order) graphics.gl.deleteTexture(this.order.texture);
      const room = Math.ceil(1.25 * rows);
      this.order = { channels, room, texture: graphics.texture(channels === 2 ? "RG32F" : "R32F", ORDER_WIDTH, room) };
    }
    this.order.count = count;
    graphics.send(this.order.texture, 0, rows, channels, list.subarray(0, rows * ORDER_WIDTH * channels));
  }

  paint() {
    const { graphics, canvas, last: { camera, views: all } } = this, views = all.filter(({ model, there }) => there || this.shown.has(model));
    if (graphics.gl.isContextLost()) return;
    if (canvas.width !== camera.width || canvas.height !== camera.height) Object.assign(canvas, { width: camera.width, height: camera.height });
    const { groups, member } = grouped(views), size = [camera.width, camera.height], background = this.scene.background;
    this.resize(size, groups);
    graphics.gl.viewport(0, 0, ...size);
    const drawn = this.atlas && this.order ? groups : [];
    drawn.forEach((group, number) => this.blend(camera, views, member, number));
    graphics.clear(this.linear.framebuffer);
    if (drawn.length > 1) this.sums(camera, groups, background);
    else if (drawn.length) this.resolve(camera, groups[0], this.targets[0], background, this.linear);
    else this.resolve({ ...camera, width: 1, height: 1 }, { space: "linear" }, this.nothing, background, this.linear);
    graphics.draw(graphics.screen(), [this.linear.textures.t_first], null);
  }

  /** Blends the splats into a group's target; those of other groups are black. */
  blend(camera, views, member, number) {
    const { graphics, atlas, order } = this, { features, own } = this.kinds[number], { width } = atlas;
    const table = frameTable(camera, views, atlas.places, order.count, member, width);
    table.data[4 * LIBRARY.tables.VIEW.DEPTHS + 3] = number;
    this.table = graphics.table(this.table, table);
    const { framebuffer } = this.targets[number], { geometry, colour } = atlas.textures;
    graphics.clear(framebuffer);
    graphics.draw(graphics.splats(features, own, width), [this.table, order.texture, geometry, colour, atlas.depth], framebuffer, { count: order.count });
  }

  resolve(camera, group, { textures }, background, target, options = {}) {
    const { graphics } = this, features = Boolean(group.view), names = ["t_first", ...(features ? ["t_second", "t_third"] : [])];
    if (options.own) names.push("t_own");
    this.resolved = graphics.table(this.resolved, resolveTable(camera, group, background, options));
    graphics.draw(graphics.resolve(features, Boolean(options.own)), [this.resolved, ...names.map((name) => textures[name])], target.framebuffer,
                  { over: options.first !== false && !options.raw });
  }

  /** Groups in one colour space are summed, then decoded; the spaces' light adds up (picture.py). */
  sums(camera, groups, background) {
    const { graphics, targets } = this, spaces = [...new Set(groups.map(({ space }) => space))];
    spaces.forEach((space, k) => {
      graphics.clear(this.sum.framebuffer);
      groups.forEach((group, number) => {
        if (group.space === space) this.resolve(camera, group, targets[number], background, this.sum, { own: true, raw: true });
      });
      const textures = { ...this.sum.textures, t_own: targets[0].textures.t_own };
      this.resolve(camera, { space }, { textures }, background, this.linear, { first: k === 0, own: true, summed: true });
    });
  }

  /** Makes targets of the picture's size. */
  resize(size, groups) {
    const { graphics } = this, own = groups.length > 1;
    const kinds = groups.map(({ view }) => ({ features: Boolean(view), own })), shape = JSON.stringify([size, kinds]);
    if (shape === this.shape) return;
    for (const target of [...this.targets, ...(this.linear ? [this.linear, this.sum, this.nothing] : [])]) graphics.free(target);
    const make = (...names) => graphics.target(...size, names);
    this.targets = kinds.map(({ features }) => make("t_first", ...(features ? ["t_second", "t_third"] : []), ...(own ? ["t_own"] : [])));
    [this.linear, this.sum, this.nothing] = [make("t_first"), make("t_first"), graphics.target(1, 1, ["t_first"])];
    Object.assign(this, { kinds, shape });
  }

  /** RGBA bytes of the last draw(), the top row first. */
  pixels() {
    const { gl } = this.graphics, { width, height } = this.last.camera, out = new Uint8Array(4 * width * height), row = 4 * width;
    this.paint();
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, out);
    for (let y = 0; y < height >> 1; y++) {
      const upper = out.slice(y * row, (y + 1) * row);
      out.copyWithin(y * row, (height - 1 - y) * row, (height - y) * row);
      out.set(upper, (height - 1 - y) * row);
    }
    return out;
  }
}
