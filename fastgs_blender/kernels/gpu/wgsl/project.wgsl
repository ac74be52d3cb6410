// Slice, crop, cull and project, fused: a thread for each Gaussian, which writes its splat, or the depth NOWHERE where it is not seen.
//
// A splat is a = (centre in pixels of the image, L11, L21), b = (L22, log2 of its opacity, highest alpha, log2 of the cut), and its channels:
// log2(alpha) = log2(opacity) - (L11 dx + L21 dy)^2 - (L22 dy)^2.

//include common
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
//include spherical
//include srgb
//include grade
//include crop

const NOWHERE = 0xffffffffu;

fn size_factor(largest: f32) -> f32 {
    if look_at({LOOK_SIZED}u) == 0.0 || !(largest > 0.0) {
        return 1.0;
    }
    return clamp(largest * look_at({LOOK_SCALE}u), look_at({LOOK_SMALLEST}u), look_at({LOOK_LARGEST}u)) / largest;
}

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

// rendering/distance.py, Sampling.blurs() of one Gaussian: the blur, and the one whose share of opacity is kept.
fn blurs(position: vec3f, z: f32, largest: f32) -> vec2f {
    let blur = view.raster.x;
    let size = view.sampling.x * select(z, 1.0, has(ORTHOGRAPHIC));
    var found = max(view.sampling.z, view.sampling.y * (view.beyond.w + length(position - view.beyond.xyz)));
    if size > {MARGIN} * found {
        let k = {MARGIN} * found / size;
        return vec2f(blur, select(blur, blur * k * k, view.sampled.x != 0u));
    }
    for (var i = 0u; i < view.sampled.y && found > {MARGIN} * size; i++) {
        let at = view.sampled.z + 8u * i;
        let away = position - vec3f(extra[at], extra[at + 1u], extra[at + 2u]);
        let along = dot(away, vec3f(extra[at + 4u], extra[at + 5u], extra[at + 6u]));
        let near = abs(along) * extra[at + 3u];
        if near < found {
            let r = sqrt(max(dot(away, away) - along * along, 0.0));
            found = min(found, near + {STEEP} * max((r - view.sampling.w * largest) * extra[at + 7u] - along, 0.0) * extra[at + 3u]);
        }
    }
    let finer = max(max(found, view.sampling.z) / ({MARGIN} * size), 1.0);
    return vec2f(blur * finer * finer);
}

// oracle.nearness of a Gaussian beside the picture; factor: its axes in the camera, times their sizes.
fn nearness(p: vec3f, along: vec2f, factor: mat3x3f) -> f32 {
    let deep = length(vec3f(factor[0].z, factor[1].z, factor[2].z));
    if !(p.z < {REACH} * deep) {
        return 1.0 / p.z;
    }
    let share = min({REACH} - p.z / deep, 1.0);
    let unit = factor * (1.0 / deep); // so that products of small sizes stay numbers
    let sides = mat3x3f(cross(unit[1], unit[2]), cross(unit[2], unit[0]), cross(unit[0], unit[1]));
    let across = vec3f(along, 1.0) * sides;
    let square = dot(across, across);
    var densest = p.z;
    if square > 0.0 {
        densest = max(dot(across, p * sides) / square, 0.5 * p.z);
    }
    return (1.0 - share) / p.z + share / densest;
}

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let n = place(group, groups) * 256u + lane;
    if n >= view.size.x {
        return;
    }
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
    if faintness > look_at({LOOK_FAINTEST}u) {
        return;
    }
    let t = view.time.x;
    let mu_tau = model[mu_tau_at(n)];
    var sigma = temporal_factor(n, t, mu_tau) / faintness * look_at({LOOK_OPACITY}u);
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

    // the rows u, v of the factor J W R S of the covariance
    let axes = axes_of(unit_quaternion(turned(n, delta)));
    var bent = shear(p);
    var centre = centre_of(p);
    let scale = exp(three(scale_at(n)));
    let sizes = scale * size_factor(max(scale.x, max(scale.y, scale.z)));
    let tangent = p.xy / p.z;
    if {BENDS} && !has(ORTHOGRAPHIC) && any(-bent.xy != tangent) {
        let turned_axes = transpose(mat3x3f(view.row0.xyz, view.row1.xyz, view.row2.xyz)) * axes;
        let near_by = nearness(p, -bent.xy, mat3x3f(turned_axes[0] * sizes.x, turned_axes[1] * sizes.y, turned_axes[2] * sizes.z));
        if near_by != bent.z {
            bent.z = near_by;
            centre = view.lens.xy * ((p.xy + bent.xy * p.z) * near_by - bent.xy) + view.lens.zw;
        }
    }
    let deep = view.row2.xyz * axes;
    let u = view.lens.x * (view.row0.xyz * axes + bent.x * deep) * (sizes * bent.z);
    let v = view.lens.y * (view.row1.xyz * axes + bent.y * deep) * (sizes * bent.z);
    var both = view.raster.xx;
    if view.sampling.x > 0.0 {
        both = blurs(position, p.z, max(sizes.x, max(sizes.y, sizes.z)));
    }
    let blur = both.x;
    let normal = cross(u, v);
    let sharp = dot(normal, normal);
    let s00 = dot(u, u) + blur;
    let s01 = dot(u, v);
    let s11 = dot(v, v) + blur;
    let det = sharp + blur * (dot(u, u) + dot(v, v)) + blur * blur;
    if !(det > 0.0 && s00 + s11 <= {LIMIT}) {
        return;
    }
    if has(ANTIALIASED) {
        sigma *= sqrt(sharp / det);
        if !(sigma >= view.raster.z) {
            return;
        }
    }
    let log2_sigma = log2(sigma);
    let reach = 1.3862943611198906 * (log2_sigma - view.raster.w);
    let radius = sqrt(reach * vec2f(s00, s11));
    if !(centre.x + radius.x >= view.frame.x && centre.x - radius.x <= view.frame.y
        && centre.y + radius.y >= view.frame.z && centre.y - radius.y <= view.frame.w) {
        return;
    }

    let first = row * view.size.z;
    for (var c = 0u; c < view.size.z; c++) {
        channels[first + c] = 0.0;
    }
    let own = first + view.plan.x;
    if view.kinds.y == FEATURES {
        for (var c = 0u; c < 9u; c++) {
            let value = feature(n, c, delta) * select(1.0, delta, c >= 6u);
            if !(abs(value) <= {LIMIT}) {
                return;
            }
            channels[own + c] = value;
        }
    } else {
        var colour = vec3f(0.0);
        if view.kinds.y == SH {
            let along = seen_along(position);
            sh_terms(view.kinds.z, along / max(length(along), 1e-30));
            colour = vec3f(0.5);
            for (var b = 0u; b < (view.kinds.z + 1u) * (view.kinds.z + 1u); b++) {
                colour += terms[b] * vec3f(feature(n, 3u * b, delta), feature(n, 3u * b + 1u, delta), feature(n, 3u * b + 2u, delta));
            }
            colour = max(colour, vec3f(0.0));
        } else {
            colour = vec3f(feature(n, 0u, delta), feature(n, 1u, delta), feature(n, 2u, delta));
        }
        if look_at({LOOK_GRADED}u) != 0.0 {
            colour = graded(colour);
        }
        if !all(abs(colour) <= vec3f({LIMIT})) {
            return;
        }
        channels[own] = colour.x;
        channels[own + 1u] = colour.y;
        channels[own + 2u] = colour.z;
    }
    if view.plan.y > 0u {
        channels[first + view.plan.y - 1u] = 1.0;
    }
    if view.plan.z > 0u {
        channels[first + view.plan.z - 1u] = p.z;
    }
    if view.plan.w > 0u {
        let change = slope(deep * sizes, u, v, normal, blur, det, p.z, radius);
        channels[first + view.plan.w - 1u] = p.z - dot(change, centre - view.depths.zw);
        channels[first + view.plan.w] = change.x;
        channels[first + view.plan.w + 1u] = change.y;
    }
    var faint = 0.0;
    if both.y < blur {
        faint = 0.5 * log2((sharp + both.y * (dot(u, u) + dot(v, v)) + both.y * both.y) / det);
        if !(faint >= -{LIMIT}) {
            return;
        }
    }
    let root = sqrt(s11);
    let root_det = sqrt(det);
    splat_a[row] = vec4f(centre, SCALE * root / root_det, -SCALE * s01 / (root * root_det));
    splat_b[row] = vec4f(SCALE / root, log2_sigma + faint, view.raster.y, view.raster.w + faint);
    depths[row] = bitcast<u32>(p.z);
}
