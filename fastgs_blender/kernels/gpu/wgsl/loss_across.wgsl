// Weighted sums along the rows of three planes.

//threads job.strip.y
//include loss

@group(0) @binding(0) var<uniform> job: Loss;
@group(0) @binding(1) var<storage, read> slopes: array<f32>;
@group(0) @binding(2) var<storage, read_write> across: array<f32>;

fn thread(thread: u32) {
    let i = job.strip.x + thread;
    let n = job.strip.w;
    let own = i - job.strip.z;
    let x = i32(i / 3u % job.size.x);
    var sum = vec3f(0.0);
    for (var k = -REACH; k <= REACH; k++) {
        if x + k >= 0 && x + k < i32(job.size.x) {
            let at = u32(i32(own) + 3 * k);
            sum += tap(k + REACH) * vec3f(slopes[at], slopes[n + at], slopes[2u * n + at]);
        }
    }
    across[own] = sum.x;
    across[n + own] = sum.y;
    across[2u * n + own] = sum.z;
}
