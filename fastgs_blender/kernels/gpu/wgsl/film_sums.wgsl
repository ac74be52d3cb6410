// Add some numbers of each pixel of an exposure's sample to their sums, each tile's with its weight.

//threads job.size.x

struct Job {
    size: vec4u,   // numbers of the band; pixels before it; width; numbers of a pixel
    window: vec4u, // the window's x0, y0 from the first tile's corner; columns of tiles
    place: vec4u,  // first of the numbers in `values`, numbers of a pixel there
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> weights: array<f32>;
@group(0) @binding(2) var<storage, read> values: array<f32>;
@group(0) @binding(3) var<storage, read_write> sums: array<f32>;

//include tile_of

fn thread(i: u32) {
    let pixel = i / job.size.w;
    let value = values[pixel * job.place.y + job.place.x + i % job.size.w];
    sums[job.size.y * job.size.w + i] += weights[tile_of(job.size.y + pixel)] * value;
}
