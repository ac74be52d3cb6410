// SPDX-License-Identifier: GPL-3.0-or-later
// Niantic's library for SPZ (its build for npm, @adobe/spz):  node spz.mjs node_modules read FILE OUT
//                                                             node spz.mjs node_modules write FLOATS OUT VERSION AXES
// Floats of a Gaussian in RDF, as a PLY holds them: position 3, scale 3, rotation x y z w, opacity 1, colour 3, and 72 harmonics (degree 4).
// AXES: what the library's extension lets the file be in, such as LUF; RUB needs no extension.
import { readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

const [modules, action, source, target, version, axes] = process.argv.slice(2);
const { default: create } = await import(pathToFileURL(join(modules, "@adobe/spz/dist/spz.js")));
const spz = await create();
const WIDTHS = { positions: 3, scales: 3, rotations: 4, alphas: 1, colors: 3, sh: 72 };
const ROW = Object.values(WIDTHS).reduce((a, b) => a + b);

if (action === "read") {
    const cloud = await spz.loadSpzFromBuffer(readFileSync(source), { to: spz.CoordinateSystem.RDF });
    const out = new Float32Array(cloud.numPoints * ROW);
    let begin = 0;
    for (const [name, width] of Object.entries(WIDTHS)) {
        const own = cloud[name].length / cloud.numPoints; // of lower degrees there are fewer harmonics
        for (let i = 0; i < cloud.numPoints; i++) for (let k = 0; k < own; k++) out[i * ROW + begin + k] = cloud[name][i * own + k];
        begin += width;
    }
    writeFileSync(target, out);
} else {
    const bytes = readFileSync(source);
    const rows = new Float32Array(bytes.buffer, bytes.byteOffset, bytes.length / 4);
    const n = rows.length / ROW;
    const cloud = { numPoints: n, shDegree: 4, antialiased: false, extensions: [] };
    let begin = 0;
    for (const [name, width] of Object.entries(WIDTHS)) {
        cloud[name] = new Float32Array(n * width);
        for (let i = 0; i < n; i++) for (let k = 0; k < width; k++) cloud[name][i * width + k] = rows[i * ROW + begin + k];
        begin += width;
    }
    if (axes !== "RUB") {
        const extension = new spz.SpzExtensionCoordinateSystemAdobe();
        extension.coordinateSystem = spz.CoordinateSystem[axes];
        cloud.extensions = [extension];
    }
    writeFileSync(target, spz.saveSpzToBuffer(cloud, { version: Number(version), from: spz.CoordinateSystem.RDF, sh1Bits: 8, shRestBits: 8 }));
}
