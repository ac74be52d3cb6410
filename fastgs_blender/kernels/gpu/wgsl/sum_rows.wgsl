// Sums down the columns of `values` [rows, columns], over 64 rows each.

//threads (job.x + 63u) / 64u * job.y

@group(0) @binding(0) var<uniform> job: vec4u; // rows, columns
@group(0) @binding(1) var<storage, read> values: array<f32>;
@group(0) @binding(2) var<storage, read_write> sums: array<f32>;

fn thread(i: u32) {
    let block = i / job.y;
    let column = i % job.y;
    var total = 0.0;
    for (var row = 64u * block; row < min(64u * block + 64u, job.x); row++) {
        total += values[row * job.y + column];
    }
    sums[i] = total;
}
