// Backward pass of raster.wgsl: for each entry of a tile's list, sum the gradients of its splat over the tile's pixels
// (kernels/cpu/raster_backward.py).  The entries of one splat are written next to each other, and collect.wgsl adds them up.
//
// Each thread handles one entry.  The pixels pass through the threads as through a pipeline, from the farthest entry to the nearest: at
// each step a thread takes the pixel that the thread before it had one step earlier.  So one thread alone adds up each sum, always in one
// order.

//include common

struct Job {
    window: vec4i, // x0, y0, right, bottom in pixels of the image
    tiles: vec4i,  // first tile in x and in y, columns, rows
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> lists: array<u32>;
@group(0) @binding(2) var<storage, read> values: array<u32>;
@group(0) @binding(3) var<storage, read> splat_a: array<vec4f>;
@group(0) @binding(4) var<storage, read> splat_b: array<vec4f>;
@group(0) @binding(5) var<storage, read> channels: array<vec4f>;
@group(0) @binding(6) var<storage, read> pixels: array<vec4f>; // raster_seed.wgsl
@group(0) @binding(7) var<storage, read_write> rows: array<vec4f>;

//include splat
//include fade

const WIDTH = {QUADS}u + 2u;
const LANES = {LANES}u;

var<workgroup> state: array<vec4f, 256>; // transmittance behind, light from behind, place of the last splat, d loss / d alpha
var<workgroup> farthest: atomic<i32>;
var<workgroup> shared_end: u32;

fn index_of(pixel: vec2i) -> u32 {
    return u32((pixel.y - job.window.y) * (job.window.z - job.window.x) + pixel.x - job.window.x);
}

@compute @workgroup_size({LANES})
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let tile = place(group, groups);
    if tile >= u32(job.tiles.z * job.tiles.w) {
        return;
    }
    let corner = {TILE} * (job.tiles.xy + vec2i(i32(tile) % job.tiles.z, i32(tile) / job.tiles.z));
    let ahead = u32(job.tiles.z * job.tiles.w) + 1u; // numbers before the lists
    let area = u32((job.window.z - job.window.x) * (job.window.w - job.window.y));
    let begin = lists[tile];
    let end = lists[tile + 1u];
    if lane == 0u {
        atomicStore(&farthest, -1);
    }
    workgroupBarrier();
    for (var p = lane; p < 256u; p += LANES) {
        let own = corner + vec2i(i32(p % {TILE}u), i32(p / {TILE}u));
        state[p] = vec4f(1.0, 0.0, -1.0, 0.0);
        if all(own >= job.window.xy) && all(own < job.window.zw) {
            let pixel = pixels[index_of(own)];
            state[p] = vec4f(pixel.x, 0.0, pixel.y, pixel.z);
            atomicMax(&farthest, i32(pixel.y));
        }
    }
    workgroupBarrier();
    if lane == 0u {
        shared_end = begin + u32(atomicLoad(&farthest) + 1);
    }
    let used = workgroupUniformLoad(&shared_end);
    for (var e = used + lane; e < end; e += LANES) { // what lies behind all that the tile shows
        for (var i = 0u; i < WIDTH; i++) {
            rows[values[e - ahead] * WIDTH + i] = vec4f(0.0);
        }
    }
    for (var last = used; last > begin; last -= min(LANES, last - begin)) {
        let count = min(LANES, last - begin);
        let e = last - 1u - min(lane, count - 1u);
        let row = lists[e];
        let a = splat_a[row];
        let b = splat_b[row];
        let centre = a.xy - vec2f(corner) - 0.5;
        let number = f32(e - begin);
        var colour = array<vec4f, {QUADS}>();
        var sums = array<vec4f, {QUADS}>();
        //each c {QUADS}
        colour[c] = channels[row * {QUADS}u + c];
        //end
        var first = vec4f(0.0);  // sums of e, e u, e u dx, e u dy
        var second = vec4f(0.0); // of e dy, e dy^2, |e u|, |e u du/dy + e v dv/dy| times the emphasis
        for (var step = 0u; step < 255u + count; step++) {
            let p = step - lane;
            if lane < count && step >= lane && p < 256u {
                let pixel = state[p];
                let d = vec2f(f32(p % {TILE}u), f32(p / {TILE}u)) - centre;
                let uv = along_axes(d, a, b);
                let exponent = log2_alpha(uv, b);
                if pixel.z >= number && exponent >= b.w {
                    let free = exp2(exponent);
                    var alpha = min(free, b.z);
                    var rise = alpha; // d alpha / d ln(alpha before it fades)
                    if SMOOTH {
                        let factor = fade(alpha, exp2(b.w));
                        rise = alpha * factor.x + alpha * alpha * factor.y;
                        alpha *= factor.x;
                    }
                    let left = pixel.x / (1.0 - alpha);
                    let weight = alpha * left;
                    let at = index_of(corner + vec2i(i32(p % {TILE}u), i32(p / {TILE}u)));
                    var dot_ = pixel.w;
                    //each c {QUADS}
                    {
                        let slope = pixels[(1u + c) * area + at];
                        dot_ += dot(slope, colour[c]);
                        sums[c] += weight * slope;
                    }
                    //end
                    let more = dot_ - pixel.y;
                    state[p] = vec4f(left, pixel.y + alpha * more, pixel.zw);
                    if free < b.z {
                        let e_ = rise * left * more;
                        let eu = e_ * uv.x;
                        let ey = e_ * d.y;
                        first += vec4f(e_, eu, eu * d.x, eu * d.y);
                        second += vec4f(ey, ey * d.y, pixels[at].w * abs(vec2f(eu, eu * a.w + e_ * uv.y * b.x)));
                    }
                }
            }
            workgroupBarrier();
        }
        if lane < count {
            let at = values[e - ahead] * WIDTH;
            rows[at] = first;
            rows[at + 1u] = second;
            //each c {QUADS}
            rows[at + 2u + c] = sums[c];
            //end
        }
    }
}
