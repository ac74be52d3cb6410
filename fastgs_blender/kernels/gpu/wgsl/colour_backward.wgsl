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
const STRIDE = 129u; // odd, so that threads which read other numbers of one pixel do not wait for each other

var<workgroup> inputs: array<f32, 2322>; // 12 inputs of each pixel, number by number, then 6 hidden units
var<workgroup> slopes_of: array<f32, 1161>; // of 6 hidden units, then of red, green and blue

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
        //each c 9
        slopes[9u * pixel + c] = 0.0;
        //end
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
        //each c 3
        along += base[c] * inverse * channels[first + c];
        slopes[9u * pixel + c] = base[c] * inverse;
        //end
        var by_unit = array<f32, 6>();
        //each j 6
        by_unit[j] = select(0.0, dot(w2(i32(j)), base), found.hidden[j] > 0.0);
        slopes_of[j * STRIDE + lane] = by_unit[j];
        //end
        //each i 6
        {
            var g = 0.0;
            //each j 6
            g += matrices[12u * j + i] * by_unit[j];
            //end
            g *= inverse;
            along += g * channels[first + 3u + i];
            slopes[9u * pixel + 3u + i] = g;
        }
        //end
        if view.corner.w == NORMALISED {
            by_alpha[own] += by_weight - along * inverse;
        }
    } else {
        //each j 6
        slopes_of[j * STRIDE + lane] = 0.0;
        //end
    }
    //each i 12
    inputs[i * STRIDE + lane] = found.inputs[i / 4u][i % 4u];
    //end
    //each j 6
    inputs[(12u + j) * STRIDE + lane] = found.hidden[j];
    //end
    //each c 3
    slopes_of[(6u + c) * STRIDE + lane] = base[c];
    //end
    workgroupBarrier();
    if lane < 90u && block / blocks * view.size.y < view.size.x {
        let second = lane >= 72u; // w2's numbers
        let slope = select(lane / 12u, 6u + (lane - 72u) / 6u, second) * STRIDE;
        let input = select(lane % 12u, 12u + (lane - 72u) % 6u, second) * STRIDE;
        var total = 0.0;
        for (var i = 0u; i < PIXELS; i += 8u) {
            //each k 8
            total += slopes_of[slope + i + k] * inputs[input + i + k];
            //end
        }
        sums[(view.size.w / view.size.y * blocks + block) * 90u + lane] = total;
    }
}
