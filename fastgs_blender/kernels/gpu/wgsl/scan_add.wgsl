// Prefix sums, last part: add to each block of 2048 values the total of the blocks before it.

//include common

@group(0) @binding(0) var<uniform> length: vec4u;
@group(0) @binding(1) var<storage, read_write> values: array<u32>;
@group(0) @binding(2) var<storage, read> sums: array<u32>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = place(group, groups) * 256u + lane;
    if i < length.x {
        let sum = values[i] + sums[i / 2048u];
        values[i] = select(sum, 0xffffffffu, sum < values[i]);
    }
}
