// SPDX-License-Identifier: GPL-3.0-or-later
/** WebGL2: programs of the library's shaders, textures that hold numbers, and targets. */
import { PageError } from "./errors.js";
import { SHADERS } from "./shaders.js";

const HEAD = "#version 300 es\nprecision highp float;\nprecision highp int;\nprecision highp sampler2D;\n";
const FLAT = { v_alpha: "vec4", v_first: "vec3", v_own: "vec3" }, FEATURES = { v_second: "vec3", v_third: "vec3" };

/** The canvas's WebGL2, the same at each call; throws PageError where there is none. */
export function contextOf(canvas) {
  const options = { alpha: false, antialias: false, depth: false, stencil: false, powerPreference: "high-performance" };
  const gl = canvas.getContext("webgl2", options);
  if (!gl) throw new PageError("This page needs WebGL2, which this browser or its graphics driver does not have. Update it, or try another one.");
  return gl;
}

export class Graphics {
  constructor(canvas) {
    const gl = (this.gl = contextOf(canvas));
    this.float = Boolean(gl.getExtension("EXT_color_buffer_float") || gl.getExtension("EXT_color_buffer_half_float"));
    this.largest = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    this.programs = new Map();
    gl.bindVertexArray(gl.createVertexArray());
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 2, gl.FLOAT, false, 0, 0);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.enable(gl.BLEND);
  }

  /** The program that blends splats: their colour, or nine features; `own`: also their own share of alpha, and their depth. */
  splats(features, own, width) {
    const outputs = ["out_first", ...(features ? ["out_second", "out_third"] : []), ...(own ? ["out_own"] : [])];
    return this.program(`splats ${features} ${own}`, {
      defines: { WIDTH: width, ...(features && { FEATURES: 1 }), ...(own && { OWN: 1 }) }, outputs,
      flat: { ...FLAT, ...(features && FEATURES) }, samplers: ["t_table", "t_order", "t_geometry", "t_colour", "t_depth"],
      vertex: SHADERS.SPLAT_VERTEX, fragment: SHADERS.SPLAT_FRAGMENT,
    });
  }

  /** The program that makes scene-linear colour of them. */
  resolve(features, own) {
    return this.program(`resolve ${features} ${own}`, {
      defines: { ...(features && { FEATURES: 1 }), ...(own && { OWN: 1 }) }, outputs: ["out_colour"],
      samplers: ["t_resolve", "t_first", ...(features ? ["t_second", "t_third"] : []), ...(own ? ["t_own"] : [])],
      vertex: SHADERS.RESOLVE_VERTEX, fragment: SHADERS.RESOLVE_FRAGMENT,
    });
  }

  screen() {
    return this.program("screen", {
      outputs: ["out_colour"], samplers: ["t_shown"], vertex: SHADERS.RESOLVE_VERTEX, fragment: SHADERS.SCREEN_FRAGMENT,
    });
  }

  program(key, { defines = {}, outputs, flat = {}, samplers, vertex, fragment }) {
    if (this.programs.has(key)) return this.programs.get(key);
    const { gl } = this, lines = (list) => list.map((line) => `${line};\n`).join("");
    const head = HEAD + Object.entries(defines).map(([name, value]) => `#define ${name} ${value}\n`).join("")
      + lines(samplers.map((name) => `uniform sampler2D ${name}`));
    const between = (way) => lines([`${way} vec2 v_uv`, ...Object.entries(flat).map(([name, type]) => `flat ${way} ${type} ${name}`)]);
    const made = gl.createProgram();
    for (const [kind, text] of [
      [gl.VERTEX_SHADER, head + "in vec2 corner;\n" + between("out") + vertex],
      [gl.FRAGMENT_SHADER, head + between("in") + lines(outputs.map((name, slot) => `layout(location = ${slot}) out vec4 ${name}`)) + fragment],
    ]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(made, shader);
    }
    gl.bindAttribLocation(made, 0, "corner");
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS) && !gl.isContextLost()) {
      const logs = [gl.getProgramInfoLog(made), ...gl.getAttachedShaders(made).map((shader) => gl.getShaderInfoLog(shader))];
      throw new PageError(`The graphics driver refuses this page's shaders (${logs.filter(Boolean).join(" ").trim()}). Update it.`);
    }
    gl.useProgram(made);
    samplers.forEach((name, unit) => gl.uniform1i(gl.getUniformLocation(made, name), unit));
    this.programs.set(key, made);
    return made;
  }

  /** A texture that is read texel by texel. */
  texture(format, width, height) {
    const { gl } = this, texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl[format], width, height);
    for (const name of ["MIN", "MAG"]) gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_${name}_FILTER`], gl.NEAREST);
    for (const name of ["S", "T"]) gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_WRAP_${name}`], gl.CLAMP_TO_EDGE);
    return Object.assign(texture, { size: [width, height] });
  }

  /** Sends floats, one, two or four a texel, to rows of a texture. */
  send(texture, row, rows, channels, values) {
    const { gl } = this, format = { 1: gl.RED, 2: gl.RG, 4: gl.RGBA }[channels];
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, row, texture.size[0], rows, format, gl.FLOAT, values);
  }

  /** A texture of a small table, which is made anew where its size changes. */
  table(texture, { data, width, height }) {
    if (!texture || `${texture.size}` !== `${[width, height]}`) {
      this.gl.deleteTexture(texture);
      texture = this.texture("RGBA32F", width, height);
    }
    this.send(texture, 0, height, 4, data);
    return texture;
  }

  /** {textures by name, framebuffer} to draw into. */
  target(width, height, names) {
    const { gl } = this, framebuffer = gl.createFramebuffer(), textures = {};
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    names.forEach((name, slot) => {
      textures[name] = this.texture(this.float ? "RGBA16F" : "RGBA8", width, height);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + slot, gl.TEXTURE_2D, textures[name], 0);
    });
    gl.drawBuffers(names.map((_, slot) => gl.COLOR_ATTACHMENT0 + slot));
    return { textures, framebuffer };
  }

  free({ textures, framebuffer }) {
    for (const texture of Object.values(textures)) this.gl.deleteTexture(texture);
    this.gl.deleteFramebuffer(framebuffer);
  }

  clear(framebuffer) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
  }

  /** Draws `count` rectangles over what is there, or adds them to it. */
  draw(program, textures, framebuffer, { count = 1, over = true } = {}) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    gl.useProgram(program);
    textures.forEach((texture, unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
    });
    gl.activeTexture(gl.TEXTURE0);
    if (over) gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    else gl.blendFunc(gl.ONE, gl.ONE);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, count);
  }
}
