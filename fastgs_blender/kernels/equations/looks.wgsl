// Looks (rendering/looks.py), for colours after srgb.wgsl.  a to e are the five fours of the row that look_numbers() gives:
//
//     opacity, faintest, scale, smallest | largest, sized, graded, linear | factor, power, matrix ...

// What multiplies the standard deviations of a Gaussian of which this is the largest (looks.size_factor).
fn size_factor(largest: f32, a: vec4f, b: vec4f) -> f32 {
    if (b.y == 0.0 || !(largest > 0.0)) {
        return 1.0;
    }
    return clamp(largest * a.z, a.w, b.x) / largest;
}

fn powered(x: f32, c: vec4f) -> f32 {
    if (x > 0.0) {
        return c.x * pow(x, c.y);
    }
    if (c.y == 0.0) {
        return c.x;
    }
    return 0.0;
}

// looks.graded
fn graded(colour: vec3f, b: vec4f, c: vec4f, d: vec4f, e: vec4f) -> vec3f {
    if (b.z == 0.0) {
        return colour;
    }
    let linear: bool = b.w != 0.0;
    var given: vec3f = colour;
    if (!linear) {
        given = vec3f(to_linear(colour.x), to_linear(colour.y), to_linear(colour.z));
    }
    let x: vec3f = max(vec3f(dot(vec3f(c.zw, d.x), given), dot(d.yzw, given), dot(e.xyz, given)), vec3f(0.0));
    let changed: vec3f = vec3f(powered(x.x, c), powered(x.y, c), powered(x.z, c));
    if (linear) {
        return changed;
    }
    return vec3f(to_srgb(changed.x), to_srgb(changed.y), to_srgb(changed.z));
}
