// Weighted sums along the rows of x, y, x^2, y^2 and x y, plane by plane.

//threads job.strip.y
//include loss

@group(0) @binding(0) var<uniform> job: Loss;
@group(0) @binding(1) var<storage, read> picture: array<f32>;
@group(0) @binding(2) var<storage, read> goal: array<f32>;
@group(0) @binding(3) var<storage, read> weights: array<f32>;
@group(0) @binding(4) var<storage, read_write> moments: array<f32>;

fn thread(thread: u32) {
    let i = job.strip.x + thread;
    let x = i32(i / 3u % job.size.x);
    var mean = vec2f(0.0);
    var square = vec3f(0.0);
    for (var k = -REACH; k <= REACH; k++) {
        if x + k < 0 || x + k >= i32(job.size.x) {
            continue;
        }
        let at = u32(i32(i) + 3 * k);
        let q = goal[at];
        var p = picture[at];
        if job.size.z != 0u {
            p = q + (p - q) * min(weights[at / 3u], 1.0);
        }
        mean += tap(k + REACH) * vec2f(p, q);
        square += tap(k + REACH) * vec3f(p * p, q * q, p * q);
    }
    let n = job.strip.w;
    let own = i - job.strip.z;
    moments[own] = mean.x;
    moments[n + own] = mean.y;
    moments[2u * n + own] = square.x;
    moments[3u * n + own] = square.y;
    moments[4u * n + own] = square.z;
}
