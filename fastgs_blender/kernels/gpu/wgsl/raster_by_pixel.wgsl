// Blend the splats of each tile, in each pixel in the order in which its own ray meets them (kernels/cpu/raster_by_pixel.py): by the depths
// of their planes there.  A workgroup for each tile, a thread for each pixel.
//
// A pixel goes through its tile's list as often as it has to.  Each time it keeps the KEPT nearest of the splats that it has not yet
// blended, and blends them then.  So the order is exact, however long the list is.

//include common
//include picture

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> lists: array<u32>;
@group(0) @binding(2) var<storage, read> splat_a: array<vec4f>;
@group(0) @binding(3) var<storage, read> splat_b: array<vec4f>;
@group(0) @binding(4) var<storage, read> channels: array<vec4f>;
@group(0) @binding(5) var<storage, read> cover: array<f32>; // cover.wgsl
@group(0) @binding(6) var<storage, read_write> picture: array<vec4f>;
@group(0) @binding(7) var<storage, read_write> flat: array<f32>; // alpha, then the probes

const KEPT = 16u;

//include splat
//include core
//include occlusion

var<workgroup> batch_a: array<vec4f, 256>;
var<workgroup> batch_b: array<vec4f, 256>;
var<workgroup> batch_plane: array<vec3f, 256>;
var<workgroup> live: u32;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let tile = place(group, groups);
    if tile >= u32(job.tiles.z * job.tiles.w) {
        return;
    }
    let corner = {TILE} * (job.tiles.xy + vec2i(i32(tile) % job.tiles.z, i32(tile) / job.tiles.z));
    let pixel = corner + vec2i(i32(lane % {TILE}u), i32(lane / {TILE}u));
    let at = vec2f(pixel - corner);
    let inside = all(pixel >= job.window.xy) && all(pixel < job.window.zw);
    let out = u32((pixel.y - job.rows.x) * (job.window.z - job.window.x) + pixel.x - job.window.x);
    let from_middle = vec2f(pixel) + 0.5 - job.middle.xy;
    var done = !inside;
    var t = 1.0;
    var sum = array<vec4f, {QUADS}>();
    var median = bitcast<f32>(0x7f800000u + (lane >> 16u));
    var nearest = median;
    var count = 0.0;
    let begin = lists[tile];
    let end = lists[tile + 1u];
    // the splats that are kept, the nearest first; two of one depth as they follow each other in the list
    var depth = array<f32, KEPT>();
    var alpha = array<f32, KEPT>();
    var entry = array<u32, KEPT>();
    var blended = -FARTHEST; // depth of the last splat that was blended, and
    var last = begin;        // the entry behind it
    loop {
        var kept = 0u;
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
        for (var first = begin; first < end; first += 256u) {
            if first + lane < end {
                let row = lists[first + lane];
                let a = splat_a[row];
                batch_a[lane] = vec4f(a.xy - vec2f(corner) - 0.5, a.zw);
                batch_b[lane] = splat_b[row];
                let plane = row * 4u * {QUADS}u + u32(job.rows.z);
                batch_plane[lane] = vec3f(number(plane), number(plane + 1u), number(plane + 2u));
            }
            workgroupBarrier();
            let size = select(min(256u, end - first), 0u, done);
            for (var i = 0u; i < size; i++) {
                let a = batch_a[i];
                let b = batch_b[i];
                let exponent = log2_alpha(along_axes(at - a.xy, a, b), b);
                if !(exponent >= b.w) {
                    continue;
                }
                let plane = batch_plane[i];
                let z = plane.x + plane.y * from_middle.x + plane.z * from_middle.y;
                if z < blended || (z == blended && first + i < last) || (kept == KEPT && z >= depth[KEPT - 1u]) {
                    continue;
                }
                var k = min(kept, KEPT - 1u);
                while k > 0u && depth[k - 1u] > z {
                    depth[k] = depth[k - 1u];
                    alpha[k] = alpha[k - 1u];
                    entry[k] = entry[k - 1u];
                    k--;
                }
                depth[k] = z;
                alpha[k] = min(exp2(exponent), b.z);
                entry[k] = first + i;
                kept = min(kept + 1u, KEPT);
            }
            workgroupBarrier();
        }
        for (var k = 0u; k < kept && !done; k++) {
            let z = depth[k];
            if HOLDOUT {
                t = uncovered(t, out, z);
            }
            let weight = t * alpha[k];
            let after = t - weight;
            if !(after > {T_STOP}) {
                done = true;
                break;
            }
            let row = lists[entry[k]];
            caught += select(0.0, weight, HOLDOUT);
            //each c {QUADS}
            sum[c] += weights(c, t, weight) * channels[row * {QUADS}u + c];
            //end
            if MEDIAN > 0u && t > {MEDIAN_FROM} {
                median = z;
            }
            if FIRST > 0u && t > {FIRST_FROM} {
                nearest = z;
            }
            count += 1.0;
            t = after;
            blended = z;
            last = entry[k] + 1u;
        }
        done = done || kept < KEPT;
    }
    if !inside {
        return;
    }
    if HOLDOUT {
        t = uncovered(t, out, FARTHEST);
    }
    let own = out * u32(job.rows.y);
    deliver(out, own, t, sum, median, nearest, count);
}
