// From a Gaussian in space to an ellipse in pixels (oracle.project).  p: its centre in the camera; axes: the columns of its rotation;
// sizes: its standard deviations; row0 to row2: model to camera; lens: fx, fy, cx, cy; limits: of x / z and y / z.

struct Footprint {
    normal: vec3f, // u x v
    s00: f32,      // the covariance with the blur
    s01: f32,
    s11: f32,
    trace: f32,    // of it without the blur
    sharp: f32,    // its determinant without the blur, and with it
    det: f32,
}

// The Jacobian's third column without focal length and depth, and 1 / depth (orthographic: 0, 0, 1).
fn shear(p: vec3f, limits: vec4f, orthographic: bool) -> vec3f {
    if (orthographic) {
        return vec3f(0.0, 0.0, 1.0);
    }
    return vec3f(-clamp(p.x / p.z, limits.x, limits.y), -clamp(p.y / p.z, limits.z, limits.w), 1.0 / p.z);
}

// oracle.nearness of a Gaussian beside the picture: along is the clamped tangent, factor the axes in the camera, times their sizes.
fn nearness(p: vec3f, along: vec2f, factor: mat3x3f) -> f32 {
    let deep: f32 = length(vec3f(factor[0].z, factor[1].z, factor[2].z));
    if (!(p.z < {REACH} * deep)) {
        return 1.0 / p.z;
    }
    let share: f32 = min({REACH} - p.z / deep, 1.0);
    let unit: mat3x3f = factor * (1.0 / deep); // so that products of small sizes stay numbers
    let sides: mat3x3f = mat3x3f(cross(unit[1], unit[2]), cross(unit[2], unit[0]), cross(unit[0], unit[1]));
    let across: vec3f = vec3f(along, 1.0) * sides;
    let square: f32 = dot(across, across);
    var densest: f32 = p.z;
    if (square > 0.0) {
        densest = max(dot(across, p * sides) / square, 0.5 * p.z);
    }
    return (1.0 - share) / p.z + share / densest;
}

// What shear() gave, with 1 / the depth at which the Gaussian is linearised.
fn linearised(p: vec3f, sheared: vec3f, row0: vec3f, row1: vec3f, row2: vec3f, axes: mat3x3f, sizes: vec3f) -> vec3f {
    if (-sheared.x == p.x / p.z && -sheared.y == p.y / p.z) {
        return sheared;
    }
    let turned: mat3x3f = transpose(mat3x3f(row0, row1, row2)) * axes;
    return vec3f(sheared.xy, nearness(p, -sheared.xy, mat3x3f(turned[0] * sizes.x, turned[1] * sizes.y, turned[2] * sizes.z)));
}

// The centre in pixels.
fn centre_of(p: vec3f, sheared: vec3f, lens: vec4f, orthographic: bool) -> vec2f {
    if (orthographic) {
        return lens.xy * p.xy + lens.zw;
    }
    if (sheared.z != 1.0 / p.z) {
        return lens.xy * ((p.xy + sheared.xy * p.z) * sheared.z - sheared.xy) + lens.zw;
    }
    return lens.xy * (p.xy / p.z) + lens.zw;
}

// A row u or v of the factor J W R S; deep: the row of depths, sizes: times 1 / depth.
fn factor_row(focal: f32, row: vec3f, bend: f32, deep: vec3f, axes: mat3x3f, sizes: vec3f) -> vec3f {
    return focal * (row * axes + bend * deep) * sizes;
}

fn blurred(sharp: f32, trace: f32, blur: f32) -> f32 {
    return sharp + blur * trace + blur * blur;
}

// Sigma_2D = (J W R S)(J W R S)^T; its determinant as a sum of squares (Cauchy-Binet), which needles do not cancel.
fn footprint(u: vec3f, v: vec3f, blur: f32) -> Footprint {
    var f: Footprint;
    f.normal = cross(u, v);
    f.s00 = dot(u, u) + blur;
    f.s01 = dot(u, v);
    f.s11 = dot(v, v) + blur;
    f.trace = dot(u, u) + dot(v, v);
    f.sharp = dot(f.normal, f.normal);
    f.det = blurred(f.sharp, f.trace, blur);
    return f;
}
