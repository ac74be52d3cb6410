// Sums down the columns of `values` [rows, columns], over 64 rows each.

//include common

@group(0) @binding(0) var<uniform> job: vec4u; // rows, columns
@group(0) @binding(1) var<storage, read> values: array<f32>;
@group(0) @binding(2) var<storage, read_write> sums: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = place(group, groups) * 256u + lane;
    let block = i / job.y;
    let column = i % job.y;
    if block * 64u >= job.x {
        return;
    }
    var total = 0.0;
    for (var row = 64u * block; row < min(64u * block + 64u, job.x); row++) {
        total += values[row * job.y + column];
    }
    sums[i] = total;
}
