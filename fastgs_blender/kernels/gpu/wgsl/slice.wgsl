// A Gaussian at the view's time.  Its arrays lie in `model` one after the other: position, rotation, scale, opacity, mu_tau, temporal,
// motion, rotation_motion, features.  `extra` holds pairs (coefficient, weight) of the motion, the rotation and the colour.

const SCALE = 0.849321800288019; // sqrt(log2(e) / 2): a Mahalanobis distance to the root of the exponent of 2

fn position_at(n: u32) -> u32 { return 3u * n; }
fn rotation_at(n: u32) -> u32 { return 3u * view.size.x + 4u * n; }
fn scale_at(n: u32) -> u32 { return 7u * view.size.x + 3u * n; }
fn opacity_at(n: u32) -> u32 { return 10u * view.size.x + n; }
fn mu_tau_at(n: u32) -> u32 { return 11u * view.size.x + n; }
fn temporal_at(n: u32) -> u32 { return 12u * view.size.x + view.widths.z * n; }
fn motion_at(n: u32) -> u32 { return (12u + view.widths.z) * view.size.x + 3u * view.widths.x * n; }
fn rotation_motion_at(n: u32) -> u32 {
    return (12u + view.widths.z + 3u * view.widths.x) * view.size.x + 4u * view.widths.y * n;
}
fn features_at(n: u32) -> u32 {
    return (12u + view.widths.z + 3u * view.widths.x + 4u * view.widths.y) * view.size.x + view.widths.w * n;
}

fn three(at: u32) -> vec3f {
    return vec3f(model[at], model[at + 1u], model[at + 2u]);
}

fn four(at: u32) -> vec4f {
    return vec4f(model[at], model[at + 1u], model[at + 2u], model[at + 3u]);
}

fn term(pair: u32) -> u32 { return u32(extra[2u * pair]); }
fn weight(pair: u32) -> f32 { return extra[2u * pair + 1u]; }

// Temporal opacity (model/temporal.py).
fn temporal_factor(n: u32, t: f32, mu_tau: f32) -> f32 {
    let p = temporal_at(n);
    let delta = t - mu_tau;
    switch view.kinds.x {
        case RADIAL: {
            return exp(-exp(model[p]) * delta * delta);
        }
        case WINDOW: {
            let early = max(model[p] - t, 0.0) / exp(model[p + 2u]);
            let late = max(t - model[p + 1u], 0.0) / exp(model[p + 3u]);
            return exp(-early * early - late * late);
        }
        case WINDOWED_RADIAL: {
            let outside = max(max(model[p + 1u] - t, t - model[p + 2u]), 0.0) / exp(model[p + 3u]);
            return exp(-exp(model[p]) * delta * delta - outside * outside);
        }
        default: {
            return 1.0;
        }
    }
}

fn moved(n: u32, delta: f32) -> vec3f {
    let c = motion_at(n);
    var sum = vec3f(0.0);
    if has(MOTION_CENTRED) {
        for (var k = view.widths.x; k > 0u; k--) {
            sum = (sum + three(c + 3u * (k - 1u))) * delta;
        }
    } else {
        for (var m = 0u; m < view.terms.x; m++) {
            sum += weight(m) * three(c + 3u * term(m));
        }
    }
    return three(position_at(n)) + sum;
}

// The quaternion w x y z before it is normalised.
fn turned(n: u32, delta: f32) -> vec4f {
    let c = rotation_motion_at(n);
    var sum = vec4f(0.0);
    if has(ROTATION_CENTRED) {
        for (var k = view.widths.y; k > 0u; k--) {
            sum = (sum + four(c + 4u * (k - 1u))) * delta;
        }
    } else {
        for (var m = view.terms.x; m < view.terms.x + view.terms.y; m++) {
            sum += weight(m) * four(c + 4u * term(m));
        }
    }
    return four(rotation_at(n)) + sum;
}

// Column c of the features at this time; a decoder's time features are not yet multiplied by t - mu_tau.
fn feature(n: u32, c: u32, delta: f32) -> f32 {
    let at = features_at(n) + c;
    let width = view.kinds.w;
    var sum = 0.0;
    if has(COLOUR_CENTRED) {
        for (var k = view.flags.w; k > 0u; k--) {
            sum = (sum + model[at + width * k]) * delta;
        }
    } else {
        let first = view.terms.x + view.terms.y;
        for (var m = first; m < first + view.terms.z; m++) {
            sum += weight(m) * model[at + width * (term(m) + 1u)];
        }
    }
    return model[at] + sum;
}

fn unit_quaternion(q: vec4f) -> vec4f {
    let norm = length(q);
    return select(vec4f(1.0, 0.0, 0.0, 0.0), q / max(norm, 1e-30), norm > 1e-12);
}

// The rotation matrix of a unit quaternion; its columns are the Gaussian's axes.
fn axes_of(q: vec4f) -> mat3x3f {
    let w = q.x;
    let v = q.yzw;
    return mat3x3f(
        vec3f(1.0 - 2.0 * (v.y * v.y + v.z * v.z), 2.0 * (v.x * v.y + w * v.z), 2.0 * (v.x * v.z - w * v.y)),
        vec3f(2.0 * (v.x * v.y - w * v.z), 1.0 - 2.0 * (v.x * v.x + v.z * v.z), 2.0 * (v.y * v.z + w * v.x)),
        vec3f(2.0 * (v.x * v.z + w * v.y), 2.0 * (v.y * v.z - w * v.x), 1.0 - 2.0 * (v.x * v.x + v.y * v.y)));
}

fn in_camera(p: vec3f) -> vec3f {
    return vec3f(dot(view.row0.xyz, p) + view.row0.w, dot(view.row1.xyz, p) + view.row1.w, dot(view.row2.xyz, p) + view.row2.w);
}

// The Jacobian's third column without focal length and depth, and 1 / depth (orthographic: 0, 0, 1).
fn shear(p: vec3f) -> vec3f {
    if has(ORTHOGRAPHIC) {
        return vec3f(0.0, 0.0, 1.0);
    }
    return vec3f(-clamp(p.x / p.z, view.limits.x, view.limits.y), -clamp(p.y / p.z, view.limits.z, view.limits.w), 1.0 / p.z);
}

fn centre_of(p: vec3f) -> vec2f {
    let q = select(p.xy / p.z, p.xy, has(ORTHOGRAPHIC));
    return view.lens.xy * q + view.lens.zw;
}

// The direction in which a position is seen, not yet of unit length.
fn seen_along(p: vec3f) -> vec3f {
    return select(p - view.eye.xyz, view.eye.xyz, has(ORTHOGRAPHIC));
}
