// The gradient of the loss by each pixel's colour and, through the background and the weight of opacity, by its alpha.

//threads (job.strip.y + 2u) / 3u
//include loss

@group(0) @binding(0) var<uniform> job: Loss;
@group(0) @binding(1) var<storage, read> picture: array<f32>;
@group(0) @binding(2) var<storage, read> goal: array<f32>;
@group(0) @binding(3) var<storage, read> weights: array<f32>;
@group(0) @binding(4) var<storage, read> across: array<f32>;
@group(0) @binding(5) var<storage, read_write> by_rgb: array<f32>;
@group(0) @binding(6) var<storage, read_write> by_alpha: array<f32>;

fn thread(own: u32) {
    let pixel = job.strip.x / 3u + own;
    let n = job.strip.w;
    let y = i32(pixel / job.size.x);
    let stride = i32(3u * job.size.x);
    var counts = 1.0;
    if job.size.z != 0u {
        counts = weights[pixel];
    }
    let share = min(counts, 1.0);
    var through = 0.0;
    for (var c = 0u; c < 3u; c++) {
        let i = 3u * pixel + c;
        var sum = vec3f(0.0);
        for (var k = -REACH; k <= REACH; k++) {
            if y + k >= 0 && y + k < i32(job.size.y) {
                let at = u32(i32(i - job.strip.z) + k * stride);
                sum += tap(k + REACH) * vec3f(across[at], across[n + at], across[2u * n + at]);
            }
        }
        let q = goal[i];
        let difference = picture[i] - q;
        let p = q + difference * share;
        let value = (sum.x + 2.0 * sum.y * p + sum.z * q) * share * job.scales.y + sign(difference) * counts * job.scales.x;
        by_rgb[i] = value * job.scales.z;
        through += value * job.scales.z * job.background[c];
    }
    by_alpha[pixel] = -through - job.scales.z * job.scales.w * 3.0 / f32(job.size.w);
}
