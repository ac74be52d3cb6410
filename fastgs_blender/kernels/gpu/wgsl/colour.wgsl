// The colour of one group of channels, added to the picture's (CPU._group_colour): plain, or features through a decoder.

//include common
//include decoder

@group(0) @binding(0) var<uniform> view: Decoder;
@group(0) @binding(1) var<storage, read> channels: array<f32>;
@group(0) @binding(2) var<storage, read> weights: array<f32>;
@group(0) @binding(3) var<storage, read> matrices: array<f32>;
@group(0) @binding(4) var<storage, read_write> rgb: array<f32>;

fn look_at(which: u32) -> f32 {
    return view.look[which / 4u][which % 4u];
}

//include decode
//include srgb
//include grade

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let pixel = place(group, groups) * 256u + lane;
    if pixel >= view.size.x {
        return;
    }
    let first = pixel * view.size.z + view.plan.x;
    var colour = vec3f(channels[first], channels[first + 1u], channels[first + 2u]);
    if view.plan.w != PLAIN {
        let share = share_of(pixel);
        if share > 0.0 {
            if view.corner.w == LIFTED { // see appearance.lifted
                let whole = activated(decoded(pixel, first, 1.0).base);
                let straight = (whole - (1.0 - share) * activated(decoded(pixel, first, 0.0).base)) / share;
                colour = select(clamp(straight, vec3f(0.0), vec3f(1.0)), straight, view.plan.w == NONE) * share;
            } else {
                colour = activated(decoded(pixel, first, 1.0 / share).base) * share;
            }
            colour = select(vec3f(0.0), colour, abs(colour) <= vec3f({LIMIT}));
            if look_at({LOOK_GRADED}u) != 0.0 {
                colour = graded(colour / share) * share;
            }
        } else {
            colour = vec3f(0.0);
        }
    }
    rgb[3u * pixel] += colour.x;
    rgb[3u * pixel + 1u] += colour.y;
    rgb[3u * pixel + 2u] += colour.z;
}
