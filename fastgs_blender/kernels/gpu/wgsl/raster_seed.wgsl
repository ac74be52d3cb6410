// Write the start values of the backward pass for each pixel: (transmittance, place of the last splat, d loss / d alpha, emphasis), then
// d loss / d channels, four of them of all pixels after the other: neighbours are read together.

//threads job.size.x

struct Job {
    size: vec4u,  // pixels of the band, its first pixel in the picture, channels of the colour, depth + 1 or 0
    first: vec4u, // the band's first pixel in `slopes`, whether pixels have an emphasis: 1 otherwise
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> flat: array<f32>;    // as raster.wgsl leaves it
@group(0) @binding(2) var<storage, read> slopes: array<f32>;  // of the colour's channels
@group(0) @binding(3) var<storage, read> by_alpha: array<f32>;
@group(0) @binding(4) var<storage, read> by_depth: array<f32>;
@group(0) @binding(5) var<storage, read> emphasis: array<f32>;
@group(0) @binding(6) var<storage, read_write> pixels: array<vec4f>;

fn thread(pixel: u32) {
    let own = job.size.y + pixel;
    var much = 1.0;
    if job.first.y != 0u {
        much = emphasis[own];
    }
    pixels[pixel] = vec4f(flat[3u * pixel + 1u], flat[3u * pixel + 2u], by_alpha[own], much);
    for (var quad = 0u; quad < {QUADS}u; quad++) {
        var value = vec4f(0.0);
        for (var i = 0u; i < 4u; i++) {
            let channel = 4u * quad + i;
            if channel < job.size.z {
                value[i] = slopes[(job.first.x + pixel) * job.size.z + channel];
            }
            if channel + 1u == job.size.w {
                value[i] += by_depth[own];
            }
        }
        pixels[(1u + quad) * job.size.x + pixel] = value;
    }
}
