// Add a range of an array to a range of another array, element by element.

//include common

@group(0) @binding(0) var<uniform> job: vec4u; // how many, place of the first among those that are added, and among the sums
@group(0) @binding(1) var<storage, read> values: array<f32>;
@group(0) @binding(2) var<storage, read_write> sums: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = place(group, groups) * 256u + lane;
    if i < job.x {
        sums[job.z + i] += values[job.y + i];
    }
}
