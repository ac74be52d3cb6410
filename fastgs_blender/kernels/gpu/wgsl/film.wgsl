// Add a sample of an exposure to the film: its colour as light, and its alpha, each tile's with its weight (kernels/cpu/expose.py, collect).

//threads job.size.x

struct Job {
    size: vec4u,   // pixels of the band, of those before it; width; numbers of a pixel in `flat`
    window: vec4u, // the window's x0, y0 from the first tile's corner; columns of tiles; bit 1: there are colours, bit 2: in sRGB
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> weights: array<f32>;
@group(0) @binding(2) var<storage, read> rgb: array<f32>;
@group(0) @binding(3) var<storage, read> flat: array<f32>;
@group(0) @binding(4) var<storage, read_write> film: array<vec4f>;

//include srgb
//include tile_of

fn thread(i: u32) {
    let weight = weights[tile_of(job.size.y + i)];
    if weight == 0.0 {
        return;
    }
    let alpha = flat[i * job.size.w];
    var light = vec3f(0.0);
    if (job.window.w & 1u) != 0u && alpha > 0.0 {
        light = vec3f(rgb[3u * i], rgb[3u * i + 1u], rgb[3u * i + 2u]);
        if (job.window.w & 2u) != 0u {
            let straight = light / alpha;
            light = vec3f(to_linear(straight.x), to_linear(straight.y), to_linear(straight.z)) * alpha;
        }
    }
    film[job.size.y + i] += weight * vec4f(light, alpha);
}
