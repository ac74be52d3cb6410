// Row r of a Gaussian's motion coefficients, multiplied by the matrix in `table` where there is one (penalty.wgsl).
fn row_of(n: u32, r: u32) -> vec3f {
    let first = 3u * n * job.size.y;
    var sum = vec3f(0.0);
    if job.size.w == 0u {
        sum = vec3f(motion[first + 3u * r], motion[first + 3u * r + 1u], motion[first + 3u * r + 2u]);
    } else {
        for (var k = 0u; k < job.size.y; k++) {
            sum += table[r * job.size.y + k] * vec3f(motion[first + 3u * k], motion[first + 3u * k + 1u], motion[first + 3u * k + 2u]);
        }
    }
    return sum;
}
