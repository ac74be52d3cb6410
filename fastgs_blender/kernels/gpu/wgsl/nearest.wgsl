// The nearest depth of each pixel's points (cover.wgsl).

//include common

@group(0) @binding(0) var<uniform> job: vec4u; // pixels
@group(0) @binding(1) var<storage, read> cover: array<f32>;
@group(0) @binding(2) var<storage, read_write> nearest: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = place(group, groups) * 256u + lane;
    if i < job.x {
        nearest[i] = cover[i * {SAMPLES}u];
    }
}
