// A decoder of features (appearance.decode).  A shader has w1(h, k) and w2(h) before this: a hidden unit's weights, of its inputs 4 k to
// 4 k + 3, and of red, green and blue.

// The unit direction of the ray through a place in the picture, in the model's space; x, y, z: rows of the matrix from the camera.
fn ray_of(place: vec2f, lens: vec4f, orthographic: bool, x: vec3f, y: vec3f, z: vec3f) -> vec3f {
    var ray: vec3f = vec3f((place - lens.zw) / lens.xy, 1.0);
    if (orthographic) {
        ray = vec3f(0.0, 0.0, 1.0);
    }
    let turned: vec3f = vec3f(dot(x, ray), dot(y, ray), dot(z, ray));
    return turned / max(length(turned), 1e-30);
}

fn weighed(total: f32, w: vec4f, x: vec4f) -> f32 {
    return total + w.x * x.x + w.y * x.y + w.z * x.z + w.w * x.w;
}

fn hidden_unit(h: i32, in0: vec4f, in1: vec4f, in2: vec4f) -> f32 {
    return max(weighed(weighed(weighed(0.0, w1(h, 0), in0), w1(h, 1), in1), w1(h, 2), in2), 0.0);
}

fn activated(value: vec3f, activation: i32) -> vec3f {
    if (activation == {ACTIVATION_SIGMOID}) {
        return 1.0 / (1.0 + exp(-value));
    }
    if (activation == {ACTIVATION_CLAMP}) {
        return clamp(value, vec3f(0.0), vec3f(1.0));
    }
    return value;
}

// appearance.lifted, straight; whole and nothing: what the decoder shows of the blended sum, and of zeros.
fn lifted(whole: vec3f, nothing: vec3f, share: f32, activation: i32) -> vec3f {
    let straight: vec3f = (whole - (1.0 - share) * nothing) / share;
    if (activation == {ACTIVATION_NONE}) {
        return straight;
    }
    return clamp(straight, vec3f(0.0), vec3f(1.0));
}
