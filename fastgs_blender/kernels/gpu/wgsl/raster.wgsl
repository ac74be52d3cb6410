// Blend the splats of each tile front to back: a workgroup for each tile, a thread for each pixel (kernels/cpu/raster.py).  Threads that run
// in step have pixels in a block of 8 x 4, which a small splat misses more often than two rows of 16.

//include common
//include picture

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> lists: array<u32>;
@group(0) @binding(2) var<storage, read> splat_a: array<vec4f>;
@group(0) @binding(3) var<storage, read> splat_b: array<vec4f>;
@group(0) @binding(4) var<storage, read> channels: array<vec4f>;
@group(0) @binding(5) var<storage, read> depths: array<f32>;
@group(0) @binding(6) var<storage, read> cover: array<f32>; // cover.wgsl
@group(0) @binding(7) var<storage, read_write> picture: array<vec4f>;
@group(0) @binding(8) var<storage, read_write> flat: array<f32>; // alpha, then the probes; or with TRACE what the backward pass needs

const TRACE = {TRACE};

//include fade
//include splat
//include core
//include occlusion

const BATCH = {BATCH}u;

var<workgroup> batch_a: array<vec4f, {BATCH}>;
var<workgroup> batch_b: array<vec4f, {BATCH}>;
var<workgroup> batch_channels: array<vec4f, {BATCH} * {QUADS}>;
var<workgroup> batch_row: array<u32, {BATCH}>;
var<workgroup> live: u32;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let tile = place(group, groups);
    if tile >= u32(job.tiles.z * job.tiles.w) {
        return;
    }
    let corner = {TILE} * (job.tiles.xy + vec2i(i32(tile) % job.tiles.z, i32(tile) / job.tiles.z));
    let pixel = corner + vec2i(i32(lane % 8u + lane / 32u % 2u * 8u), i32(lane / 8u % 4u + lane / 64u * 4u));
    let at = vec2f(pixel - corner);
    let inside = all(pixel >= job.window.xy) && all(pixel < job.window.zw);
    let out = u32((pixel.y - job.rows.x) * (job.window.z - job.window.x) + pixel.x - job.window.x);
    let from_middle = vec2f(pixel) + 0.5 - job.middle.xy;
    let behind = farthest_cover(out, inside);
    var done = !inside;
    var t = 1.0;
    var sum = array<vec4f, {QUADS}>();
    var median = bitcast<f32>(0x7f800000u + (lane >> 16u));
    var nearest = median;
    var count = 0.0;
    var last = -1.0;
    let begin = lists[tile];
    let end = lists[tile + 1u];
    for (var first = begin; first < end; first += BATCH) {
        if lane == 0u {
            live = 0u;
        }
        workgroupBarrier();
        if !done {
            live = 1u;
        }
        if workgroupUniformLoad(&live) == 0u {
            break;
        }
        if lane < BATCH && first + lane < end {
            let row = lists[first + lane];
            batch_row[lane] = row;
            let a = splat_a[row];
            batch_a[lane] = vec4f(a.xy - vec2f(corner) - 0.5, a.zw);
            batch_b[lane] = splat_b[row];
            //each c {QUADS}
            batch_channels[c * BATCH + lane] = channels[row * {QUADS}u + c];
            //end
        }
        workgroupBarrier();
        let size = min(BATCH, end - first);
        for (var i = 0u; i < size; i++) {
            if done {
                break;
            }
            let row = batch_row[i];
            if HOLDOUT {
                t = uncovered(t, out, depths[row]);
            }
            let a = batch_a[i];
            let b = batch_b[i];
            let exponent = log2_alpha(along_axes(at - a.xy, a, b), b);
            if !(exponent >= b.w) {
                continue;
            }
            if HOLDOUT && !(behind >= plane_depth(row * 4u * {QUADS}u + u32(job.rows.z), from_middle)) {
                continue;
            }
            var alpha = min(exp2(exponent), b.z);
            if SMOOTH {
                alpha *= fade(alpha, exp2(b.w)).x;
            }
            let weight = t * alpha;
            let after = t - weight;
            if !(after > {T_STOP}) {
                done = true;
                break;
            }
            caught += select(0.0, weight, HOLDOUT);
            //each c {QUADS}
            sum[c] += weights(c, t, weight) * batch_channels[c * BATCH + i];
            //end
            if MEDIAN > 0u && t > {MEDIAN_FROM} {
                median = depths[row];
            }
            if FIRST > 0u && t > {FIRST_FROM} {
                nearest = depths[row];
            }
            count += 1.0;
            last = f32(first + i - begin);
            t = after;
        }
        workgroupBarrier();
    }
    if !inside {
        return;
    }
    if HOLDOUT {
        t = uncovered(t, out, FARTHEST);
    }
    let own = out * u32(job.rows.y);
    deliver(out, own, t, sum, median, nearest, count);
    if TRACE {
        flat[own + 1u] = t;
        flat[own + 2u] = last;
    }
}
