// Fill an array with 0, 1, 2 ...

//include common

@group(0) @binding(0) var<uniform> length: vec4u;
@group(0) @binding(1) var<storage, read_write> values: array<u32>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = place(group, groups) * 256u + lane;
    if i < length.x {
        values[i] = i;
    }
}
