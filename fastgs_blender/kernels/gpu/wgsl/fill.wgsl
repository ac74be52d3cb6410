// Write the same numbers into some channels of the splats of a pack: those of a quantity that all Gaussians of an instance share.

//threads job.size.x

struct Job {
    size: vec4u,  // splats, the first one, channels of a splat, the first channel
    width: vec4u, // how many numbers
    values: array<vec4f, 4>,
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read_write> channels: array<f32>;

fn thread(n: u32) {
    for (var i = 0u; i < job.width.x; i++) {
        channels[(job.size.y + n) * job.size.z + job.size.w + i] = job.values[i / 4u][i % 4u];
    }
}
