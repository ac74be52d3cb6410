// Write the same numbers into some channels of the splats of a pack: those of a quantity that all Gaussians of an instance share.

//include common

struct Job {
    size: vec4u,  // splats, the first one, channels of a splat, the first channel
    width: vec4u, // how many numbers
    values: array<vec4f, 4>,
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read_write> channels: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let n = place(group, groups) * 256u + lane;
    if n >= job.size.x {
        return;
    }
    for (var i = 0u; i < job.width.x; i++) {
        channels[(job.size.y + n) * job.size.z + job.size.w + i] = job.values[i / 4u][i % 4u];
    }
}
