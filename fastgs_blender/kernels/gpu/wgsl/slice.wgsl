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

fn temporal_of(n: u32) -> vec4f {
    var p = vec4f(0.0);
    for (var i = 0u; i < view.widths.z; i++) {
        p[i] = model[temporal_at(n) + i];
    }
    return p;
}

fn term(pair: u32) -> u32 { return u32(extra[2u * pair]); }
fn weight(pair: u32) -> f32 { return extra[2u * pair + 1u]; }

// A vector of three numbers, with 0 behind them, or of four.
fn coefficient(at: u32, width: u32) -> vec4f {
    if width == 3u {
        return vec4f(three(at), 0.0);
    }
    return four(at);
}

// A sum of coefficients from number `at` on: `count` of them times powers of delta, or those of the pairs first..last with their weights.
fn series(at: u32, width: u32, count: u32, centred: bool, first: u32, last: u32, delta: f32) -> vec4f {
    var sum = vec4f(0.0);
    if centred {
        for (var k = count; k > 0u; k--) {
            sum = (sum + coefficient(at + width * (k - 1u), width)) * delta;
        }
    } else {
        for (var m = first; m < last; m++) {
            sum += weight(m) * coefficient(at + width * term(m), width);
        }
    }
    return sum;
}

fn moved(n: u32, delta: f32) -> vec3f {
    return three(position_at(n)) + series(motion_at(n), 3u, view.widths.x, has(MOTION_CENTRED), 0u, view.terms.x, delta).xyz;
}

// The quaternion w x y z before it is normalised.
fn turned(n: u32, delta: f32) -> vec4f {
    let last = view.terms.x + view.terms.y;
    return four(rotation_at(n)) + series(rotation_motion_at(n), 4u, view.widths.y, has(ROTATION_CENTRED), view.terms.x, last, delta);
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

fn in_camera(p: vec3f) -> vec3f {
    return vec3f(dot(view.row0.xyz, p) + view.row0.w, dot(view.row1.xyz, p) + view.row1.w, dot(view.row2.xyz, p) + view.row2.w);
}

// The direction in which a position is seen, not yet of unit length.
fn seen_along(p: vec3f) -> vec3f {
    return select(p - view.eye.xyz, view.eye.xyz, has(ORTHOGRAPHIC));
}
