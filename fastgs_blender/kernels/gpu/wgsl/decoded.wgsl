// The decoder of feature splatting at a pixel; `matrices` holds w1 [6, 12], then w2 [3, 6].

struct Decoded {
    inputs: array<vec4f, 3>,
    hidden: array<f32, 6>,
    base: vec3f, // before the activation
}

fn w1(h: i32, k: i32) -> vec4f {
    let at = u32(12 * h + 4 * k);
    return vec4f(matrices[at], matrices[at + 1u], matrices[at + 2u], matrices[at + 3u]);
}

fn w2(h: i32) -> vec3f {
    let at = 72u + u32(h);
    return vec3f(matrices[at], matrices[at + 6u], matrices[at + 12u]);
}

// The weight that the features are divided by, and their colour multiplied with.
fn share_of(pixel: u32) -> f32 {
    return select(weights[pixel * view.plan.z + view.plan.y], 1.0, view.corner.w == PREMULTIPLIED);
}

fn decoded(pixel: u32, first: u32, inverse: f32) -> Decoded {
    var out: Decoded;
    let place = view.corner.xy + vec2f(f32(pixel % view.size.y), f32(pixel / view.size.y)) + 0.5;
    let ray = ray_of(place, view.lens, view.corner.z != 0.0, view.ray_x.xyz, view.ray_y.xyz, view.ray_z.xyz);
    let direction = vec3f(channels[first + 3u], channels[first + 4u], channels[first + 5u]) * inverse;
    let time = vec3f(channels[first + 6u], channels[first + 7u], channels[first + 8u]) * inverse;
    out.inputs = array<vec4f, 3>(vec4f(direction, time.x), vec4f(time.yz, view.ray_x.w, view.ray_y.w), vec4f(view.ray_z.w, ray));
    out.base = vec3f(channels[first], channels[first + 1u], channels[first + 2u]) * inverse;
    //each h 6
    out.hidden[h] = hidden_unit(i32(h), out.inputs[0], out.inputs[1], out.inputs[2]);
    out.base += w2(i32(h)) * out.hidden[h];
    //end
    return out;
}

fn shown(found: Decoded) -> vec3f {
    return activated(found.base, i32(view.plan.w));
}
