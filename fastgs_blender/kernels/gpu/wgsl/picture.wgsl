// What the two stages that blend have in common: their job, their probes, and what they write.

struct Job {
    window: vec4i, // x0, y0, right, bottom in pixels of the image
    tiles: vec4i,  // first tile in x and in y, columns, rows
    rows: vec4i,   // the picture's first row, of the image; numbers of a pixel in `flat`; first channel of the splats' planes
    middle: vec4f, // of the image, where planes begin
}

const MEDIAN = {MEDIAN}; // places of the probes in `flat`, 0: not wanted
const FIRST = {FIRST};
const COUNT = {COUNT};
const HELD = {HELD}u; // the first place of two, with a holdout: the light that it stops, and which share of the pixel it covers

// Write a pixel: `picture`, and `flat` from its number `own` on; t: the transmittance behind all splats and triangles.
fn deliver(pixel: u32, own: u32, t: f32, sum: array<vec4f, {QUADS}>, median: f32, nearest: f32, count: f32) {
    //each c {QUADS}
    picture[pixel * {QUADS}u + c] = sum[c];
    //end
    flat[own] = select(1.0 - t, caught, HOLDOUT);
    if MEDIAN > 0u {
        flat[own + MEDIAN] = median;
    }
    if FIRST > 0u {
        flat[own + FIRST] = nearest;
    }
    if COUNT > 0u {
        flat[own + COUNT] = count;
    }
    if HOLDOUT {
        flat[own + HELD] = stopped;
        flat[own + HELD + 1u] = f32(taken) / f32(POINTS);
    }
}
