// Slice, crop, cull and project, fused: a thread for each Gaussian, which writes its splat, or the depth NOWHERE where it is not seen.
//
// A splat is a = (centre in pixels of the image, L11, L21), b = (L22, log2 of its opacity, highest alpha, log2 of the cut), and its channels:
// log2(alpha) = log2(opacity) - (L11 dx + L21 dy)^2 - (L22 dy)^2.

//threads view.size.x
//include view

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> model: array<f32>;
@group(0) @binding(2) var<storage, read> extra: array<f32>;
@group(0) @binding(3) var<storage, read> hidden: array<u32>;
@group(0) @binding(4) var<storage, read_write> splat_a: array<vec4f>;
@group(0) @binding(5) var<storage, read_write> splat_b: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> channels: array<f32>;
@group(0) @binding(7) var<storage, read_write> depths: array<u32>;

//include slice
//include temporal
//include rotation
//include projection
//include sampling
//include spherical
//include appearance
//include srgb
//include looks
//include crop

const NOWHERE = 0xffffffffu;

// Change of a splat's depth by pixel in x and y (oracle.plane); deep: how far the ends of the axes lie in depth; normal: u x v.
// Written with cross products, which lose fewer digits than the covariances.
// With BLURRED planes the blur is a part of the covariance, and det its determinant.
fn slope(deep: vec3f, u: vec3f, v: vec3f, normal: vec3f, blur: f32, det: f32, z: f32, radius: vec2f) -> vec2f {
    var change = vec2f(dot(cross(deep, v), normal), dot(cross(u, deep), normal));
    if has(BLURRED) {
        change = (change + blur * vec2f(dot(u, deep), dot(v, deep))) / det;
    } else {
        change /= dot(normal, normal);
    }
    let total = dot(abs(change), radius);
    if total > z {
        change = change * (z / total);
    }
    if !(abs(change.x) <= {LIMIT} && abs(change.y) <= {LIMIT}) {
        return vec2f(0.0);
    }
    return change;
}

fn captured(source: vec2i, k: i32) -> vec4f {
    let at = u32(source.x + 4 * k);
    return vec4f(extra[at], extra[at + 1u], extra[at + 2u], extra[at + 3u]);
}

fn thread(n: u32) {
    let row = view.size.y + n;
    depths[row] = NOWHERE;
    if has(HIDDEN) {
        let number = view.size.w + n;
        if ((hidden[number / 32u] >> (number % 32u)) & 1u) != 0u {
            return;
        }
    }
    let rest = three(position_at(n)) - view.ball.xyz;
    if dot(rest, rest) > view.ball.w {
        return;
    }
    let faintness = 1.0 + exp(-model[opacity_at(n)]);
    if faintness > view.look[0].y {
        return;
    }
    let t = view.time.x;
    let mu_tau = model[mu_tau_at(n)];
    var sigma = temporal_factor(i32(view.kinds.x), t, mu_tau, temporal_of(n)) / faintness * view.look[0].x;
    if !(sigma >= view.raster.z) {
        return;
    }
    let delta = t - mu_tau;
    let position = moved(n, delta);
    if view.terms.w > 0u {
        sigma *= crop_share(position);
        if !(sigma >= view.raster.z) {
            return;
        }
    }
    let p = in_camera(position);
    if !(p.z > view.depths.x && p.z <= view.depths.y) {
        return;
    }

    let flat = has(ORTHOGRAPHIC);
    let axes = axes_of(unit_quaternion(turned(n, delta)));
    let scale = exp(three(scale_at(n)));
    let sizes = scale * size_factor(max(scale.x, max(scale.y, scale.z)), view.look[0], view.look[1]);
    var bent = shear(p, view.limits, flat);
    if {BENDS} && !flat {
        bent = linearised(p, bent, view.row0.xyz, view.row1.xyz, view.row2.xyz, axes, sizes);
    }
    let centre = centre_of(p, bent, view.lens, flat);
    let deep = view.row2.xyz * axes;
    let u = factor_row(view.lens.x, view.row0.xyz, bent.x, deep, axes, sizes * bent.z);
    let v = factor_row(view.lens.y, view.row1.xyz, bent.y, deep, axes, sizes * bent.z);
    var both = view.raster.xx;
    if view.sampling.x > 0.0 {
        both = blurs(vec2i(i32(view.sampled.z), 0), i32(view.sampled.y), view.raster.x, view.sampling.x * select(p.z, 1.0, flat),
                     view.sampled.x != 0u, view.beyond, vec4f(view.sampling.yzw, view.time.y), position,
                     max(sizes.x, max(sizes.y, sizes.z)));
    }
    let blur = both.x;
    let found = footprint(u, v, blur);
    if !(found.det > 0.0 && found.s00 + found.s11 <= {LIMIT}) {
        return;
    }
    if has(ANTIALIASED) {
        sigma *= sqrt(found.sharp / found.det);
        if !(sigma >= view.raster.z) {
            return;
        }
    }
    let log2_sigma = log2(sigma);
    let reach = 1.3862943611198906 * (log2_sigma - view.raster.w);
    let radius = sqrt(reach * vec2f(found.s00, found.s11));
    if !(centre.x + radius.x >= view.frame.x && centre.x - radius.x <= view.frame.y
        && centre.y + radius.y >= view.frame.z && centre.y - radius.y <= view.frame.w) {
        return;
    }

    let first = row * view.size.z;
    for (var c = 0u; c < view.size.z; c++) {
        channels[first + c] = 0.0;
    }
    let own = first + view.plan.x;
    var shown = appear(n, delta, position);
    if view.kinds.y != FEATURES {
        let colour = graded(vec3f(shown[0], shown[1], shown[2]), view.look[1], view.look[2], view.look[3], view.look[4]);
        shown[0] = colour.x;
        shown[1] = colour.y;
        shown[2] = colour.z;
    }
    for (var c = 0u; c < appearance_numbers(); c++) {
        if !(abs(shown[c]) <= {LIMIT}) {
            return;
        }
        channels[own + c] = shown[c];
    }
    if view.plan.y > 0u {
        channels[first + view.plan.y - 1u] = 1.0;
    }
    if view.plan.z > 0u {
        channels[first + view.plan.z - 1u] = p.z;
    }
    if view.plan.w > 0u {
        let change = slope(deep * sizes, u, v, found.normal, blur, found.det, p.z, radius);
        channels[first + view.plan.w - 1u] = p.z - dot(change, centre - view.depths.zw);
        channels[first + view.plan.w] = change.x;
        channels[first + view.plan.w + 1u] = change.y;
    }
    var faint = 0.0;
    if both.y < blur {
        faint = 0.5 * log2(blurred(found.sharp, found.trace, both.y) / found.det);
        if !(faint >= -{LIMIT}) {
            return;
        }
    }
    let root = sqrt(found.s11);
    let root_det = sqrt(found.det);
    splat_a[row] = vec4f(centre, SCALE * root / root_det, -SCALE * found.s01 / (root * root_det));
    splat_b[row] = vec4f(SCALE / root, log2_sigma + faint, view.raster.y, view.raster.w + faint);
    depths[row] = bitcast<u32>(p.z);
}
