// The square root of each pixel's weighted absolute difference over the picture's mean of it, of the sums of loss_similarity.wgsl.

//threads job.x

@group(0) @binding(0) var<uniform> job: vec4u; // pixels, whether they have weights
@group(0) @binding(1) var<storage, read> picture: array<f32>;
@group(0) @binding(2) var<storage, read> goal: array<f32>;
@group(0) @binding(3) var<storage, read> weights: array<f32>;
@group(0) @binding(4) var<storage, read> sums: array<f32>;
@group(0) @binding(5) var<storage, read_write> emphasis: array<f32>;

fn thread(pixel: u32) {
    var total = 0.0;
    for (var c = 0u; c < 3u; c++) {
        total += abs(picture[3u * pixel + c] - goal[3u * pixel + c]);
    }
    if job.y != 0u {
        total *= weights[pixel];
    }
    emphasis[pixel] = sqrt(total / (3.0 * max(sums[1] / (3.0 * f32(job.x)), 1e-6)));
}
