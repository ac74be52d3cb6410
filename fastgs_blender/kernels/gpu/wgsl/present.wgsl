// 1 for each splat that is drawn, else 0.

//include common

@group(0) @binding(0) var<uniform> job: vec4u; // splats
@group(0) @binding(1) var<storage, read> depths: array<u32>;
@group(0) @binding(2) var<storage, read_write> present: array<u32>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = place(group, groups) * 256u + lane;
    if i < job.x {
        present[i] = u32(depths[i] != 0xffffffffu);
    }
}
