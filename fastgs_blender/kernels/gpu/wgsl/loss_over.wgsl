// Composite a band of a rendered picture over the background.

//include common

struct Part {
    size: vec4u, // pixels, the first one in the whole picture, numbers of a pixel in `rgb` and in `alpha`
    background: vec4f,
}

@group(0) @binding(0) var<uniform> job: Part;
@group(0) @binding(1) var<storage, read> rgb: array<f32>;
@group(0) @binding(2) var<storage, read> alpha: array<f32>;
@group(0) @binding(3) var<storage, read_write> picture: array<f32>;
@group(0) @binding(4) var<storage, read_write> cover: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let pixel = place(group, groups) * 256u + lane;
    if pixel >= job.size.x {
        return;
    }
    let own = job.size.y + pixel;
    let left = 1.0 - alpha[pixel * job.size.w];
    cover[own] = 1.0 - left;
    for (var c = 0u; c < 3u; c++) {
        picture[3u * own + c] = rgb[pixel * job.size.z + c] + left * job.background[c];
    }
}
