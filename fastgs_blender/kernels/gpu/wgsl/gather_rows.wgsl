// The numbers of the rows that gather.wgsl copies.

//include common

@group(0) @binding(0) var<uniform> job: vec4u; // splats
@group(0) @binding(1) var<storage, read> order: array<u32>;
@group(0) @binding(2) var<storage, read> places: array<u32>;
@group(0) @binding(3) var<storage, read_write> rows: array<u32>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let k = place(group, groups) * 256u + lane;
    if k < job.x && places[k] != places[k + 1u] {
        rows[places[k]] = order[k];
    }
}
