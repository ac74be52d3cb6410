// Widen the splats that move too far from one sample of an exposure to the next: along their way, or all around where the lens spreads them.
// Their optical depth spreads with them, so that what is opaque stays so (kernels/cpu/expose.py, _draw_out).

//threads job.size.x

struct Job {
    size: vec4u,  // splats
    steps: vec4f, // number of samples, less one
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> paths: array<vec4f>; // way in x and in y while the shutter is open, radius of the blur, steps needed
@group(0) @binding(2) var<storage, read> depths: array<u32>;
@group(0) @binding(3) var<storage, read_write> splat_a: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> splat_b: array<vec4f>;

const SCALE = 0.849321800288019; // as in slice.wgsl

fn thread(n: u32) {
    if depths[n] == 0xffffffffu {
        return;
    }
    let path = paths[n];
    if !(path.w > 1.5 * job.steps.x) {
        return;
    }
    let a = splat_a[n];
    let b = splat_b[n];
    let way = path.xy / job.steps.x;
    let round = path.z * path.z / job.steps.x / 3.0;
    // the covariance, to which way way^T / 6 and round are added; with sums of squares, which do not cancel
    let root11 = SCALE / b.x;
    let root_det = root11 * SCALE / a.z;
    let s11 = root11 * root11;
    let s01 = -a.w / a.z * s11;
    let s00 = (root_det * root_det + s01 * s01) / s11;
    let u = a.z * way.x + a.w * way.y;
    let v = b.x * way.y;
    let det = root_det * root_det;
    let wider = det * (1.0 + (u * u + v * v) / (6.0 * SCALE * SCALE)) + round * (s00 + s11 + dot(way, way) / 6.0 + round);
    let wide01 = s01 + way.x * way.y / 6.0;
    let wide11 = s11 + way.y * way.y / 6.0 + round;
    let opacity = min(exp2(b.y), b.z);
    let thinner = 1.0 - pow(1.0 - opacity, sqrt(det / wider));
    splat_a[n] = vec4f(a.xy, SCALE * sqrt(wide11 / wider), -SCALE * wide01 / sqrt(wide11 * wider));
    splat_b[n] = vec4f(SCALE / sqrt(wide11), max(log2(max(thinner, 1e-30)), b.w), b.zw);
}
