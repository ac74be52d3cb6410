// The norms of the coefficients of motion (protocol.MotionNorm): each Gaussian's part of the penalty, and its gradient.
//
// The coefficients [K, 3] are turned into R rows by the matrix in `table` [R, K], after which it holds the weights [3 R] / (N extent).

//threads job.size.x

struct Job {
    size: vec4u,  // Gaussians, K, R, whether there is a matrix
    norm: vec4f,  // width of what is rounded off, scale of the gradient, Gaussians of all pieces
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> motion: array<f32>;
@group(0) @binding(2) var<storage, read> since: array<f32>;
@group(0) @binding(3) var<storage, read> table: array<f32>;
@group(0) @binding(4) var<storage, read> squares: array<f32>; // with GROUP: the sums of penalty_squares.wgsl
@group(0) @binding(5) var<storage, read_write> gradient: array<f32>;
@group(0) @binding(6) var<storage, read_write> values: array<f32>;

//include penalty_row

fn thread(n: u32) {
    let weights = select(0u, job.size.y * job.size.z, job.size.w != 0u);
    var total = 0.0;
    for (var r = 0u; r < job.size.z; r++) {
        let row = row_of(n, r);
        var slope: vec3f;
        for (var i = 0u; i < 3u; i++) {
            let weight = table[weights + 3u * r + i];
            if {GROUP} {
                let size = sqrt(squares[3u * r + i] / job.norm.z + job.norm.x * job.norm.x);
                slope[i] = weight * row[i] / size;
                total += weight * (size - job.norm.x); // of which N Gaussians each have a part
            } else {
                let bent = clamp(row[i] / job.norm.x, -1.0, 1.0);
                slope[i] = weight * bent;
                total += weight * bent * (row[i] - 0.5 * job.norm.x * bent);
            }
        }
        slope *= job.norm.y * since[n];
        if job.size.w == 0u {
            add(3u * (n * job.size.y + r), slope);
        } else {
            for (var k = 0u; k < job.size.y; k++) {
                add(3u * (n * job.size.y + k), table[r * job.size.y + k] * slope);
            }
        }
    }
    values[n] = total;
}

fn add(at: u32, value: vec3f) {
    for (var i = 0u; i < 3u; i++) {
        gradient[at + i] += value[i];
    }
}
