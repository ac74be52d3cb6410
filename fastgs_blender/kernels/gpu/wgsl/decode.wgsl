// The decoder of feature splatting at a pixel (model/appearance.py, decode); `matrices` holds w1 [6, 12], then w2 [3, 6].

struct Decoded {
    inputs: array<f32, 12>,
    hidden: array<f32, 6>,
    base: vec3f, // before the activation
}

// The weight that the features are divided by, and their colour multiplied with.
fn share_of(pixel: u32) -> f32 {
    return select(weights[pixel * view.plan.z + view.plan.y], 1.0, view.corner.w == PREMULTIPLIED);
}

fn decoded(pixel: u32, first: u32, inverse: f32) -> Decoded {
    var out: Decoded;
    for (var i = 0u; i < 6u; i++) {
        out.inputs[i] = channels[first + 3u + i] * inverse;
    }
    out.inputs[6] = view.ray_x.w;
    out.inputs[7] = view.ray_y.w;
    out.inputs[8] = view.ray_z.w;
    let place = view.corner.xy + vec2f(f32(pixel % view.size.y), f32(pixel / view.size.y)) + 0.5;
    var ray = vec3f((place - view.lens.zw) / view.lens.xy, 1.0);
    if view.corner.z != 0.0 {
        ray = vec3f(0.0, 0.0, 1.0);
    }
    let turned = vec3f(dot(view.ray_x.xyz, ray), dot(view.ray_y.xyz, ray), dot(view.ray_z.xyz, ray));
    let unit = turned / max(length(turned), 1e-30);
    out.inputs[9] = unit.x;
    out.inputs[10] = unit.y;
    out.inputs[11] = unit.z;
    out.base = vec3f(channels[first], channels[first + 1u], channels[first + 2u]) * inverse;
    for (var j = 0u; j < 6u; j++) {
        var total = 0.0;
        for (var i = 0u; i < 12u; i++) {
            total += matrices[12u * j + i] * out.inputs[i];
        }
        out.hidden[j] = max(total, 0.0);
        out.base += vec3f(matrices[72u + j], matrices[78u + j], matrices[84u + j]) * out.hidden[j];
    }
    return out;
}

fn activated(value: vec3f) -> vec3f {
    if view.plan.w == SIGMOID {
        return 1.0 / (1.0 + exp(-value));
    }
    return select(value, clamp(value, vec3f(0.0), vec3f(1.0)), view.plan.w == CLAMP);
}
