// Copy the rows of splats that are drawn, one after the other.

//include common

@group(0) @binding(0) var<uniform> job: vec4u; // splats, numbers of a row
@group(0) @binding(1) var<storage, read> depths: array<u32>;
@group(0) @binding(2) var<storage, read> places: array<u32>; // of each splat among those that are drawn
@group(0) @binding(3) var<storage, read> values: array<u32>;
@group(0) @binding(4) var<storage, read_write> copies: array<u32>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = place(group, groups) * 256u + lane;
    if i < job.x && depths[i] != 0xffffffffu {
        for (var c = 0u; c < job.y; c++) {
            copies[places[i] * job.y + c] = values[i * job.y + c];
        }
    }
}
