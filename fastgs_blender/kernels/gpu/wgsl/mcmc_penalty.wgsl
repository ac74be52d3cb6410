// The gradients of MCMC's weights on opacities and scales.

//threads job.size.x

struct Job {
    size: vec4u,    // rows
    weights: vec4f, // of an opacity; of a scale, per unit
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> opacity: array<f32>;
@group(0) @binding(2) var<storage, read> scale: array<f32>;
@group(0) @binding(3) var<storage, read_write> by_opacity: array<f32>;
@group(0) @binding(4) var<storage, read_write> by_scale: array<f32>;

fn thread(row: u32) {
    let o = 1.0 / (1.0 + exp(-opacity[row]));
    by_opacity[row] += job.weights.x * o * (1.0 - o);
    for (var i = 3u * row; i < 3u * row + 3u; i++) {
        by_scale[i] += job.weights.y * exp(scale[i]);
    }
}
