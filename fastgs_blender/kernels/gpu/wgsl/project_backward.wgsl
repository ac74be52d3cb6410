// Backward pass of project.wgsl: from the sums of each splat to the gradients of its Gaussian (kernels/cpu/project_backward.py).  What the
// forward pass computed is computed again.  `gradient` is laid out as `model` and holds zeros.

//include common
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
//include spherical
//include spherical_slope

const LN2 = 0.6931471805599453;

// g is the gradient of the factor's logarithm; writes that of the parameters, returns that of mu_tau.
fn temporal_slope(n: u32, t: f32, mu_tau: f32, g: f32) -> f32 {
    let p = temporal_at(n);
    switch view.kinds.x {
        case RADIAL, WINDOWED_RADIAL: {
            let delta = t - mu_tau;
            let speed = exp(model[p]);
            gradient[p] = -g * speed * delta * delta;
            if view.kinds.x == WINDOWED_RADIAL {
                let width = exp(model[p + 3u]);
                let outside = max(max(model[p + 1u] - t, t - model[p + 2u]), 0.0) / width;
                if model[p + 1u] - t >= t - model[p + 2u] {
                    gradient[p + 1u] = -2.0 * g * outside / width;
                } else {
                    gradient[p + 2u] = 2.0 * g * outside / width;
                }
                gradient[p + 3u] = 2.0 * g * outside * outside;
            }
            return 2.0 * g * speed * delta;
        }
        case WINDOW: {
            let before = exp(model[p + 2u]);
            let after = exp(model[p + 3u]);
            let early = max(model[p] - t, 0.0) / before;
            let late = max(t - model[p + 1u], 0.0) / after;
            gradient[p] = -2.0 * g * early / before;
            gradient[p + 1u] = 2.0 * g * late / after;
            gradient[p + 2u] = 2.0 * g * early * early;
            gradient[p + 3u] = 2.0 * g * late * late;
            return 0.0;
        }
        default: {
            return 0.0;
        }
    }
}

// From the gradient of moved() to those of its coefficients; returns that of delta.
fn spread_motion(n: u32, delta: f32, g: vec3f) -> f32 {
    let c = motion_at(n);
    var slope = 0.0;
    if has(MOTION_CENTRED) {
        var power = 1.0;
        for (var k = 0u; k < view.widths.x; k++) {
            slope += f32(k + 1u) * power * dot(g, three(c + 3u * k));
            power *= delta;
            for (var i = 0u; i < 3u; i++) {
                gradient[c + 3u * k + i] = g[i] * power;
            }
        }
    } else {
        for (var m = 0u; m < view.terms.x; m++) {
            for (var i = 0u; i < 3u; i++) {
                gradient[c + 3u * term(m) + i] = weight(m) * g[i];
            }
        }
    }
    return slope;
}

fn spread_rotation(n: u32, delta: f32, g: vec4f) -> f32 {
    let c = rotation_motion_at(n);
    var slope = 0.0;
    if has(ROTATION_CENTRED) {
        var power = 1.0;
        for (var k = 0u; k < view.widths.y; k++) {
            slope += f32(k + 1u) * power * dot(g, four(c + 4u * k));
            power *= delta;
            for (var i = 0u; i < 4u; i++) {
                gradient[c + 4u * k + i] = g[i] * power;
            }
        }
    } else {
        for (var m = view.terms.x; m < view.terms.x + view.terms.y; m++) {
            for (var i = 0u; i < 4u; i++) {
                gradient[c + 4u * term(m) + i] = weight(m) * g[i];
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

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let n = place(group, groups) * 256u + lane;
    if n >= view.size.x {
        return;
    }
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
    let bent = shear(p);
    let sizes = exp(three(scale_at(n))) * bent.z;
    let deep = view.row2.xyz * axes;
    let u = view.lens.x * (view.row0.xyz * axes + bent.x * deep) * sizes;
    let v = view.lens.y * (view.row1.xyz * axes + bent.y * deep) * sizes;
    let blur = view.raster.x;
    let normal = cross(u, v);
    let sharp = dot(normal, normal);
    let s01 = dot(u, v);
    let s11 = dot(v, v) + blur;
    let det = sharp + blur * (dot(u, u) + dot(v, v)) + blur * blur;

    gradient[opacity_at(n)] = g_sigma * (1.0 - 1.0 / (1.0 + exp(-model[opacity_at(n)])));
    let g_mu = temporal_slope(n, t, mu_tau, g_sigma);

    // the triangle of the inverse covariance: L11 = SCALE sqrt(s11 / det), L21 = -SCALE s01 / sqrt(s11 det), L22 = SCALE / sqrt(s11)
    let root = sqrt(s11);
    let root_det = sqrt(det);
    let g11 = -2.0 * LN2 * first.z * SCALE * root / root_det;
    let g21 = -2.0 * LN2 * first.w * SCALE / (root * root_det);
    let g22 = -2.0 * LN2 * b.x * second.y * SCALE / root;
    var g_det = -0.5 * (g11 - g21 * s01) / det;
    let g_s11 = 0.5 * (g11 + g21 * s01 - g22) / s11;
    let g_s01 = -g21;
    var g_sharp = 0.0;
    if has(ANTIALIASED) {
        g_det -= 0.5 * g_sigma / det;
        g_sharp = 0.5 * g_sigma / sharp;
    }
    // det = sharp + blur (u.u + v.v) + blur^2, sharp = |u x v|^2
    let along_sharp = 2.0 * (g_sharp + g_det);
    let gu_ = along_sharp * cross(v, normal) + 2.0 * blur * g_det * u + g_s01 * v;
    let gv_ = along_sharp * cross(normal, u) + 2.0 * (blur * g_det + g_s11) * v + g_s01 * u;
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
    var g_delta = 0.0;
    let own = view.plan.x;
    if view.kinds.y == SH {
        let seen = seen_along(position);
        let distance = max(length(seen), 1e-30);
        let d = seen / distance;
        let bands = (view.kinds.z + 1u) * (view.kinds.z + 1u);
        sh_terms(view.kinds.z, d);
        var colour = vec3f(0.5);
        for (var k = 0u; k < bands; k++) {
            colour += terms[k] * vec3f(feature(n, 3u * k, delta), feature(n, 3u * k + 1u, delta), feature(n, 3u * k + 2u, delta));
        }
        let light = select(vec3f(0.0), vec3f(by[own], by[own + 1u], by[own + 2u]), colour > vec3f(0.0));
        for (var k = 0u; k < bands; k++) {
            let value = terms[k];
            terms[k] = 0.0;
            for (var i = 0u; i < 3u; i++) {
                terms[k] += light[i] * feature(n, 3u * k + i, delta);
                g_delta += spread_feature(n, 3u * k + i, delta, value * light[i]);
            }
        }
        if !has(ORTHOGRAPHIC) {
            let h = sh_slope(view.kinds.z, d);
            g += (h - dot(h, d) * d) / distance;
        }
    } else {
        for (var c = 0u; c < view.kinds.w; c++) {
            let value = by[own + c];
            if c >= 6u {
                g_delta += value * feature(n, c, delta);
            }
            g_delta += spread_feature(n, c, delta, value * select(1.0, delta, c >= 6u));
        }
    }

    // time
    for (var i = 0u; i < 3u; i++) {
        gradient[position_at(n) + i] = g[i];
    }
    g_delta += spread_motion(n, delta, g);
    let g_turn = quaternion_slope(q, g_axes);
    for (var i = 0u; i < 4u; i++) {
        gradient[rotation_at(n) + i] = g_turn[i];
    }
    g_delta += spread_rotation(n, delta, g_turn);
    gradient[mu_tau_at(n)] = g_mu - select(g_delta, 0.0, has(DETACHED));
}
