// Backward pass of colour.wgsl for a model's decoder (kernels/cpu/decode_backward.py): gradients of the features, of their weight (added to
// `by_alpha`), and, summed over each workgroup's pixels, of the decoder's matrices: 72 numbers of w1, then 18 of w2.  A workgroup's pixels
// lie in one row, so the sums are the same in whatever bands the picture is drawn.

//include common
//include decoder

@group(0) @binding(0) var<uniform> view: Decoder;
@group(0) @binding(1) var<storage, read> channels: array<f32>;
@group(0) @binding(2) var<storage, read> weights: array<f32>;
@group(0) @binding(3) var<storage, read> matrices: array<f32>;
@group(0) @binding(4) var<storage, read> by_rgb: array<f32>;
@group(0) @binding(5) var<storage, read_write> slopes: array<f32>;
@group(0) @binding(6) var<storage, read_write> by_alpha: array<f32>;
@group(0) @binding(7) var<storage, read_write> sums: array<f32>;

//include decode
//include decoded

const PIXELS = 128u;

var<workgroup> inputs: array<f32, 1536>; // 12 numbers of each pixel, number by number
var<workgroup> hidden: array<f32, 768>;
var<workgroup> by_hidden: array<f32, 768>;
var<workgroup> by_base: array<f32, 384>;

@compute @workgroup_size(128)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let block = place(group, groups);
    let blocks = (view.size.y + PIXELS - 1u) / PIXELS; // of a row
    let column = block % blocks * PIXELS + lane;
    let pixel = block / blocks * view.size.y + column;
    let own = view.size.w + pixel; // in the whole picture
    var share = 0.0;
    if column < view.size.y && pixel < view.size.x {
        share = share_of(pixel);
        for (var c = 0u; c < 9u; c++) {
            slopes[9u * pixel + c] = 0.0;
        }
    }
    var found: Decoded;
    var base = vec3f(0.0);
    if share > 0.0 {
        let first = pixel * view.size.z + view.plan.x;
        let inverse = 1.0 / share;
        found = decoded(pixel, first, inverse);
        let colour = shown(found);
        let given = vec3f(by_rgb[3u * own], by_rgb[3u * own + 1u], by_rgb[3u * own + 2u]);
        var by_weight = dot(given, colour);
        var slope = vec3f(1.0);
        if view.plan.w == SIGMOID {
            slope = colour * (1.0 - colour);
        } else if view.plan.w == CLAMP {
            slope = select(vec3f(0.0), vec3f(1.0), (found.base >= vec3f(0.0)) & (found.base <= vec3f(1.0)));
        }
        base = given * slope * share;
        var along = 0.0;
        for (var c = 0u; c < 3u; c++) {
            let g = base[c] * inverse;
            along += g * channels[first + c];
            slopes[9u * pixel + c] = g;
        }
        for (var j = 0u; j < 6u; j++) {
            let g = dot(w2(i32(j)), base);
            by_hidden[j * PIXELS + lane] = select(0.0, g, found.hidden[j] > 0.0);
        }
        for (var i = 0u; i < 6u; i++) {
            var g = 0.0;
            for (var j = 0u; j < 6u; j++) {
                g += matrices[12u * j + i] * by_hidden[j * PIXELS + lane];
            }
            g *= inverse;
            along += g * channels[first + 3u + i];
            slopes[9u * pixel + 3u + i] = g;
        }
        if view.corner.w == NORMALISED {
            by_alpha[own] += by_weight - along * inverse;
        }
    } else {
        for (var j = 0u; j < 6u; j++) {
            by_hidden[j * PIXELS + lane] = 0.0;
        }
    }
    for (var i = 0u; i < 12u; i++) {
        inputs[i * PIXELS + lane] = found.inputs[i / 4u][i % 4u];
    }
    for (var j = 0u; j < 6u; j++) {
        hidden[j * PIXELS + lane] = found.hidden[j];
    }
    for (var c = 0u; c < 3u; c++) {
        by_base[c * PIXELS + lane] = base[c];
    }
    workgroupBarrier();
    if lane < 90u && block / blocks * view.size.y < view.size.x {
        var total = 0.0;
        for (var i = 0u; i < PIXELS; i++) {
            if lane < 72u {
                total += by_hidden[lane / 12u * PIXELS + i] * inputs[lane % 12u * PIXELS + i];
            } else {
                total += by_base[(lane - 72u) / 6u * PIXELS + i] * hidden[(lane - 72u) % 6u * PIXELS + i];
            }
        }
        sums[(view.size.w / view.size.y * blocks + block) * 90u + lane] = total;
    }
}
