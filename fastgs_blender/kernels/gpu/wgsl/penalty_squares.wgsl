// The squares of all rows [N, 3 R] (penalty.wgsl).

//threads job.size.x * job.size.z

struct Job {
    size: vec4u, // Gaussians, K, R, whether there is a matrix
    norm: vec4f,
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> motion: array<f32>;
@group(0) @binding(2) var<storage, read> table: array<f32>;
@group(0) @binding(3) var<storage, read_write> squares: array<f32>;

//include penalty_row

fn thread(i: u32) {
    let row = row_of(i / job.size.z, i % job.size.z);
    squares[3u * i] = row.x * row.x;
    squares[3u * i + 1u] = row.y * row.y;
    squares[3u * i + 2u] = row.z * row.z;
}
