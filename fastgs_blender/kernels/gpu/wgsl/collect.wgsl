// Add the gradients of each splat's entries in the tile lists to its sums, in the order of its tiles.  Bands go on where the one above
// them ended, so the sums have the same bytes however the picture is divided.

//threads length.x

@group(0) @binding(0) var<uniform> length: vec4u; // splats; first Gaussian of `sums`, and their number
@group(0) @binding(1) var<storage, read> order: array<u32>;
@group(0) @binding(2) var<storage, read> runs: array<u32>;
@group(0) @binding(3) var<storage, read> rows: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> sums: array<vec4f>;

const WIDTH = {QUADS}u + 2u;

fn thread(k: u32) {
    if runs[k] == runs[k + 1u] {
        return;
    }
    let row = order[k] - length.y;
    if row >= length.z { // what lies before the first is far beyond the last, too
        return;
    }
    let at = row * WIDTH;
    var total = array<vec4f, {QUADS} + 2>();
    for (var i = 0u; i < WIDTH; i++) {
        total[i] = sums[at + i];
    }
    for (var e = runs[k]; e < runs[k + 1u]; e++) {
        for (var i = 0u; i < WIDTH; i++) {
            total[i] += rows[e * WIDTH + i];
        }
    }
    for (var i = 0u; i < WIDTH; i++) {
        sums[at + i] = total[i];
    }
}
