// Write 1 for each Gaussian that the view draws, for the optimiser.

//include common

@group(0) @binding(0) var<uniform> job: vec4u; // Gaussians
@group(0) @binding(1) var<storage, read> depths: array<u32>;
@group(0) @binding(2) var<storage, read_write> seen: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let n = place(group, groups) * 256u + lane;
    if n < job.x && depths[n] != 0xffffffffu {
        seen[n] = 1.0;
    }
}
