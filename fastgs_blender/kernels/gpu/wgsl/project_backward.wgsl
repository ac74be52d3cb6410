// Backward pass of project.wgsl: from the sums of each splat to the gradients of its Gaussian (kernels/cpu/project_backward.py).  What the
// forward pass computed is computed again.  `gradient` is laid out as `model` and holds zeros.

//threads view.size.x
//include view

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> model: array<f32>;
@group(0) @binding(2) var<storage, read> extra: array<f32>;
@group(0) @binding(3) var<storage, read> depths: array<u32>;
@group(0) @binding(4) var<storage, read> splat_a: array<vec4f>;
@group(0) @binding(5) var<storage, read> splat_b: array<vec4f>;
@group(0) @binding(6) var<storage, read> sums: array<vec4f>;
@group(0) @binding(7) var<storage, read_write> gradient: array<f32>;

//include slice
//include temporal
//include rotation
//include projection
//include spherical
//include appearance

const LN2 = 0.6931471805599453;

// From the gradient of series() to those of its coefficients; returns that of delta.
fn spread(at: u32, width: u32, count: u32, centred: bool, first: u32, last: u32, delta: f32, g: vec4f) -> f32 {
    var slope = 0.0;
    if centred {
        var power = 1.0;
        for (var k = 0u; k < count; k++) {
            let c = coefficient(at + width * k, width);
            slope += f32(k + 1u) * power * select(dot(g, c), dot(g.xyz, c.xyz), width == 3u); // three are not added up as four are
            power *= delta;
            for (var i = 0u; i < width; i++) {
                gradient[at + width * k + i] = g[i] * power;
            }
        }
    } else {
        for (var m = first; m < last; m++) {
            for (var i = 0u; i < width; i++) {
                gradient[at + width * term(m) + i] = weight(m) * g[i];
            }
        }
    }
    return slope;
}

// From the gradient g of feature(n, c) to those of the columns; returns that of delta.
fn spread_feature(n: u32, c: u32, delta: f32, g: f32) -> f32 {
    let at = features_at(n) + c;
    let width = view.kinds.w;
    gradient[at] = g;
    var slope = 0.0;
    if has(COLOUR_CENTRED) {
        var power = 1.0;
        for (var k = 1u; k <= view.flags.w; k++) {
            slope += f32(k) * power * g * model[at + width * k];
            power *= delta;
            gradient[at + width * k] = g * power;
        }
    } else {
        let first = view.terms.x + view.terms.y;
        for (var m = first; m < first + view.terms.z; m++) {
            gradient[at + width * (term(m) + 1u)] = weight(m) * g;
        }
    }
    return slope;
}

// The gradient of a quaternion before it was normalised, from those of the columns of its rotation matrix.
fn quaternion_slope(sum: vec4f, g: mat3x3f) -> vec4f {
    let norm = length(sum);
    if !(norm > 1e-12) {
        return vec4f(0.0);
    }
    let q = sum / norm;
    let w = q.x;
    let x = q.y;
    let y = q.z;
    let z = q.w;
    let by = 2.0 * vec4f(
        x * (g[1].z - g[2].y) + y * (g[2].x - g[0].z) + z * (g[0].y - g[1].x),
        w * (g[1].z - g[2].y) + y * (g[1].x + g[0].y) + z * (g[2].x + g[0].z) - 2.0 * x * (g[1].y + g[2].z),
        w * (g[2].x - g[0].z) + x * (g[1].x + g[0].y) + z * (g[2].y + g[1].z) - 2.0 * y * (g[0].x + g[2].z),
        w * (g[0].y - g[1].x) + x * (g[2].x + g[0].z) + y * (g[2].y + g[1].z) - 2.0 * z * (g[0].x + g[1].y));
    return (by - dot(by, q) * q) / norm;
}

fn thread(n: u32) {
    let row = view.size.y + n;
    if depths[row] == 0xffffffffu {
        return;
    }
    let at = n * ({QUADS}u + 2u);
    var by = array<f32, 4 * {QUADS}>(); // gradients of the channels
    let first = sums[at];
    let second = sums[at + 1u];
    var nothing = all(first == vec4f(0.0)) && all(second == vec4f(0.0));
    for (var c = 0u; c < {QUADS}u; c++) {
        let value = sums[at + 2u + c];
        nothing = nothing && all(value == vec4f(0.0));
        for (var i = 0u; i < 4u; i++) {
            by[4u * c + i] = value[i];
        }
    }
    if nothing {
        return;
    }
    let a = splat_a[row];
    let b = splat_b[row];
    let g_mean = 2.0 * LN2 * vec2f(a.z * first.y, a.w * first.y + b.x * b.x * second.x);
    let g_sigma = first.x; // d loss / d ln(opacity)

    let t = view.time.x;
    let mu_tau = model[mu_tau_at(n)];
    let delta = t - mu_tau;
    let position = moved(n, delta);
    let p = in_camera(position);
    let q = turned(n, delta);
    let axes = axes_of(unit_quaternion(q));
    let bent = shear(p, view.limits, has(ORTHOGRAPHIC));
    let sizes = exp(three(scale_at(n))) * bent.z;
    let deep = view.row2.xyz * axes;
    let u = factor_row(view.lens.x, view.row0.xyz, bent.x, deep, axes, sizes);
    let v = factor_row(view.lens.y, view.row1.xyz, bent.y, deep, axes, sizes);
    let blur = view.raster.x;
    let found = footprint(u, v, blur);

    gradient[opacity_at(n)] = g_sigma * (1.0 - 1.0 / (1.0 + exp(-model[opacity_at(n)])));
    let kind = i32(view.kinds.x);
    let temporal = temporal_of(n);
    let g_temporal = temporal_slope(kind, t, mu_tau, temporal, g_sigma);
    for (var i = 0u; i < view.widths.z; i++) {
        gradient[temporal_at(n) + i] = g_temporal[i];
    }
    let g_mu = temporal_rate(kind, t, mu_tau, temporal, g_sigma);

    // the triangle of the inverse covariance: L11 = SCALE sqrt(s11 / det), L21 = -SCALE s01 / sqrt(s11 det), L22 = SCALE / sqrt(found.s11)
    let root = sqrt(found.s11);
    let root_det = sqrt(found.det);
    let g11 = -2.0 * LN2 * first.z * SCALE * root / root_det;
    let g21 = -2.0 * LN2 * first.w * SCALE / (root * root_det);
    let g22 = -2.0 * LN2 * b.x * second.y * SCALE / root;
    var g_det = -0.5 * (g11 - g21 * found.s01) / found.det;
    let g_s11 = 0.5 * (g11 + g21 * found.s01 - g22) / found.s11;
    let g_s01 = -g21;
    var g_sharp = 0.0;
    if has(ANTIALIASED) {
        g_det -= 0.5 * g_sigma / found.det;
        g_sharp = 0.5 * g_sigma / found.sharp;
    }
    // det = sharp + blur (u.u + v.v) + blur^2, sharp = |u x v|^2
    let along_sharp = 2.0 * (g_sharp + g_det);
    let gu_ = along_sharp * cross(v, found.normal) + 2.0 * blur * g_det * u + g_s01 * v;
    let gv_ = along_sharp * cross(found.normal, u) + 2.0 * (blur * g_det + g_s11) * v + g_s01 * u;
    let g_scale = gu_ * u + gv_ * v;
    for (var i = 0u; i < 3u; i++) {
        gradient[scale_at(n) + i] = g_scale[i];
    }

    // the axes, and through the shear and the depth the position in the camera
    let gu = gu_ * view.lens.x * sizes;
    let gv = gv_ * view.lens.y * sizes;
    let side_u = view.row0.xyz + bent.x * view.row2.xyz;
    let side_v = view.row1.xyz + bent.y * view.row2.xyz;
    let g_axes = mat3x3f(gu.x * side_u + gv.x * side_v, gu.y * side_u + gv.y * side_v, gu.z * side_u + gv.z * side_v);
    var g = vec3f(view.lens.xy * g_mean, 0.0);
    if view.plan.z > 0u {
        g.z = by[view.plan.z - 1u];
    }
    if !has(ORTHOGRAPHIC) {
        let tangent = p.xy / p.z;
        if tangent.x > view.limits.x && tangent.x < view.limits.y {
            g.x -= dot(gu, deep);
        }
        if tangent.y > view.limits.z && tangent.y < view.limits.w {
            g.y -= dot(gv, deep);
        }
        g.x /= p.z;
        g.y /= p.z;
        g.z -= g.x * tangent.x + g.y * tangent.y + (g_scale.x + g_scale.y + g_scale.z) / p.z;
    }
    g = view.row0.xyz * g.x + view.row1.xyz * g.y + view.row2.xyz * g.z;

    // colour; in g_delta what comes through the time since mu_tau: of the motion, of the decoder's time features, of colours that change
    var by_shown = array<f32, 9>();
    for (var c = 0u; c < appearance_numbers(); c++) {
        by_shown[c] = by[view.plan.x + c];
    }
    let g_shown = appear_backward(n, delta, position, by_shown);
    if !has(ORTHOGRAPHIC) {
        g += g_shown.xyz;
    }
    var g_delta = g_shown.w;

    // time
    for (var i = 0u; i < 3u; i++) {
        gradient[position_at(n) + i] = g[i];
    }
    g_delta += spread(motion_at(n), 3u, view.widths.x, has(MOTION_CENTRED), 0u, view.terms.x, delta, vec4f(g, 0.0));
    let g_turn = quaternion_slope(q, g_axes);
    for (var i = 0u; i < 4u; i++) {
        gradient[rotation_at(n) + i] = g_turn[i];
    }
    g_delta += spread(rotation_motion_at(n), 4u, view.widths.y, has(ROTATION_CENTRED), view.terms.x, view.terms.x + view.terms.y, delta,
                      g_turn);
    gradient[mu_tau_at(n)] = g_mu - select(g_delta, 0.0, has(DETACHED));
}
