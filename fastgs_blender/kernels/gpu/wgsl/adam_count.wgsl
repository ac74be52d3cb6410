// Count a step of the rows that have moved.

//include common

@group(0) @binding(0) var<uniform> job: vec4u; // rows, whether all have moved
@group(0) @binding(1) var<storage, read> seen: array<f32>;
@group(0) @binding(2) var<storage, read_write> count: array<i32>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let row = place(group, groups) * 256u + lane;
    if row < job.x && (job.y != 0u || seen[row] != 0.0) {
        count[row] += 1;
    }
}
