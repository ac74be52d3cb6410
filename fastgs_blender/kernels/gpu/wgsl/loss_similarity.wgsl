// SSIM of each number: its derivatives by mean, mean square and mean product, plane by plane; and each workgroup's sums of 1 - SSIM,
// of |x - y|, of (x - y)^2 and of what a third of the pixel's cover lacks to 1.

//include common
//include loss

@group(0) @binding(0) var<uniform> job: Loss;
@group(0) @binding(1) var<storage, read> picture: array<f32>;
@group(0) @binding(2) var<storage, read> goal: array<f32>;
@group(0) @binding(3) var<storage, read> weights: array<f32>;
@group(0) @binding(4) var<storage, read> cover: array<f32>;
@group(0) @binding(5) var<storage, read> moments: array<f32>;
@group(0) @binding(6) var<storage, read_write> slopes: array<f32>;
@group(0) @binding(7) var<storage, read_write> sums: array<vec4f>;

const C1 = 0.0001;
const C2 = 0.0009;

var<workgroup> parts: array<vec4f, 256>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let block = place(group, groups);
    let i = job.strip.x + block * 256u + lane;
    let n = job.strip.w;
    let own = i - job.strip.z;
    var part = vec4f(0.0);
    if block * 256u + lane < job.strip.y {
        let stride = i32(3u * job.size.x);
        let y = i32(i) / stride;
        var mean = vec2f(0.0);
        var square = vec3f(0.0);
        for (var k = -REACH; k <= REACH; k++) {
            if y + k < 0 || y + k >= i32(job.size.y) {
                continue;
            }
            let at = u32(i32(own) + k * stride);
            mean += tap(k + REACH) * vec2f(moments[at], moments[n + at]);
            square += tap(k + REACH) * vec3f(moments[2u * n + at], moments[3u * n + at], moments[4u * n + at]);
        }
        let a = 2.0 * mean.x * mean.y + C1;
        let c = dot(mean, mean) + C1;
        let e = 2.0 * (square.z - mean.x * mean.y) + C2;
        let d = square.x - mean.x * mean.x + (square.y - mean.y * mean.y) + C2;
        let inverse = 1.0 / (c * d);
        let ssim = a * e * inverse;
        var counts = 1.0;
        if job.size.z != 0u {
            counts = weights[i / 3u];
        }
        let by_product = 2.0 * a * inverse;
        let by_square = -ssim * c * inverse;
        let by_mean = 2.0 * (mean.y * e - mean.x * ssim * d) * inverse - mean.y * by_product - 2.0 * mean.x * by_square;
        slopes[own] = by_mean * counts;
        slopes[n + own] = by_square * counts;
        slopes[2u * n + own] = by_product * counts;
        let difference = picture[i] - goal[i];
        if i - job.counted.x < job.counted.y {
            part = vec4f((1.0 - ssim) * counts, abs(difference) * counts, difference * difference, (1.0 - cover[i / 3u]) / 3.0);
        }
    }
    parts[lane] = part;
    workgroupBarrier();
    for (var half = 128u; half > 0u; half /= 2u) {
        if lane < half {
            parts[lane] += parts[lane + half];
        }
        workgroupBarrier();
    }
    if lane == 0u && block * 256u < job.strip.y {
        sums[block] = parts[0];
    }
}
