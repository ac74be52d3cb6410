// The colour of one group of channels, added to the picture's (CPU._group_colour): plain, or features through a decoder.

//threads view.size.x
//include decoder

@group(0) @binding(0) var<uniform> view: Decoder;
@group(0) @binding(1) var<storage, read> channels: array<f32>;
@group(0) @binding(2) var<storage, read> weights: array<f32>;
@group(0) @binding(3) var<storage, read> matrices: array<f32>;
@group(0) @binding(4) var<storage, read_write> rgb: array<f32>;

//include decode
//include decoded
//include srgb
//include looks

fn thread(pixel: u32) {
    let first = pixel * view.size.z + view.plan.x;
    var colour = vec3f(channels[first], channels[first + 1u], channels[first + 2u]);
    if view.plan.w != PLAIN {
        let share = share_of(pixel);
        if share > 0.0 {
            if view.corner.w == LIFTED { // see appearance.lifted
                let whole = shown(decoded(pixel, first, 1.0));
                colour = lifted(whole, shown(decoded(pixel, first, 0.0)), share, i32(view.plan.w)) * share;
            } else {
                colour = shown(decoded(pixel, first, 1.0 / share)) * share;
            }
            colour = select(vec3f(0.0), colour, abs(colour) <= vec3f({LIMIT}));
            if view.look[1].z != 0.0 {
                colour = graded(colour / share, view.look[1], view.look[2], view.look[3], view.look[4]) * share;
            }
        } else {
            colour = vec3f(0.0);
        }
    }
    rgb[3u * pixel] += colour.x;
    rgb[3u * pixel + 1u] += colour.y;
    rgb[3u * pixel + 2u] += colour.z;
}
