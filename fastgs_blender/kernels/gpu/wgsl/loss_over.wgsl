// Composite a band of a rendered picture over the background.

//threads job.size.x

struct Part {
    size: vec4u, // pixels, the first one in the whole picture, numbers of a pixel in `rgb` and in `alpha`
    background: vec4f,
}

@group(0) @binding(0) var<uniform> job: Part;
@group(0) @binding(1) var<storage, read> rgb: array<f32>;
@group(0) @binding(2) var<storage, read> alpha: array<f32>;
@group(0) @binding(3) var<storage, read_write> picture: array<f32>;
@group(0) @binding(4) var<storage, read_write> cover: array<f32>;

fn thread(pixel: u32) {
    let own = job.size.y + pixel;
    let left = 1.0 - alpha[pixel * job.size.w];
    cover[own] = 1.0 - left;
    for (var c = 0u; c < 3u; c++) {
        picture[3u * own + c] = rgb[pixel * job.size.z + c] + left * job.background[c];
    }
}
