// Draw the triangles of a holdout: the depth of the nearest in each of POINTS points of each pixel (kernels/cpu/holdout.py), in order.
// A workgroup for each tile, a thread for each pixel.
//
// A triangle is four vec4: its three edges a, b, c with a x + b y + c >= 0 inside, each with its least or greatest nearness (1 / depth) or
// 0; and p, q, r with nearness = p x + q y + r (orthographic: depth).  x and y are counted from the window's corner.

//include common

struct Job {
    window: vec4i,  // x0, y0, right, bottom in pixels of the image
    tiles: vec4i,   // first tile in x and in y, columns, rows
    rows: vec4i,    // the picture's first row, of the image; first tile's number in `lists`; 1 if depth is what is linear
    limits: vec4f,  // depth beyond which nothing is hidden; the window's corner
    points: array<vec4f, {SAMPLES} / 2>,
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> lists: array<u32>;
@group(0) @binding(2) var<storage, read> triangles: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> cover: array<f32>;

const POINTS = {SAMPLES}u;
const EDGE = {EDGE};

// The most that an edge's value may be in the pixel at a place.
fn most_of(edge: vec4f, at: vec2f) -> f32 {
    return edge.x * at.x + edge.y * at.y + edge.z + max(edge.x, 0.0) + max(edge.y, 0.0) + EDGE * (abs(edge.x) + abs(edge.y));
}

fn within(edge: vec4f, at: vec2f) -> bool {
    return edge.x * at.x + edge.y * at.y + edge.z >= -EDGE * (abs(edge.x) + abs(edge.y));
}

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let tile = place(group, groups);
    if tile >= u32(job.tiles.z * job.tiles.w) {
        return;
    }
    let corner = {TILE} * (job.tiles.xy + vec2i(i32(tile) % job.tiles.z, i32(tile) / job.tiles.z));
    let pixel = corner + vec2i(i32(lane % {TILE}u), i32(lane / {TILE}u));
    if any(pixel < job.window.xy) || any(pixel >= job.window.zw) {
        return;
    }
    let at = vec2f(pixel) - job.limits.yz;
    var near = array<f32, {SAMPLES}>();
    let own = tile + u32(job.rows.y);
    for (var k = lists[own]; k < lists[own + 1u]; k++) {
        let triangle = 4u * lists[k];
        let a = triangles[triangle];
        let b = triangles[triangle + 1u];
        let c = triangles[triangle + 2u];
        if most_of(a, at) < 0.0 || most_of(b, at) < 0.0 || most_of(c, at) < 0.0 {
            continue;
        }
        let linear = triangles[triangle + 3u];
        for (var s = 0u; s < POINTS; s++) {
            let pair = job.points[s / 2u];
            let place = at + select(pair.xy, pair.zw, s % 2u == 1u);
            if within(a, place) && within(b, place) && within(c, place) {
                var nearness = linear.x * place.x + linear.y * place.y + linear.z;
                if job.rows.z != 0 {
                    nearness = 1.0 / nearness;
                }
                near[s] = max(near[s], clamp(nearness, a.w, b.w));
            }
        }
    }
    for (var s = 0u; s < POINTS; s++) { // sorted: the nearest first
        let value = near[s];
        var place = s;
        while place > 0u && near[place - 1u] < value {
            near[place] = near[place - 1u];
            place--;
        }
        near[place] = value;
    }
    let first = u32((pixel.y - job.rows.x) * (job.window.z - job.window.x) + pixel.x - job.window.x) * POINTS;
    for (var s = 0u; s < POINTS; s++) {
        let depth = 1.0 / max(near[s], 1e-37);
        cover[first + s] = select({FARTHEST}, depth, near[s] > 0.0 && depth <= job.limits.x);
    }
}
