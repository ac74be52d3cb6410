// Loss, mean absolute difference, SSIM and mean squared difference, of the sums of loss_similarity.wgsl.

struct Job {
    scales: vec4f, // numbers of the picture, d, weight of opacity
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> sums: array<f32>;
@group(0) @binding(2) var<storage, read_write> values: array<f32>;

@compute @workgroup_size(1)
fn main() {
    let dissimilar = sums[0] / job.scales.x;
    let l1 = sums[1] / job.scales.x;
    values[0] = (1.0 - job.scales.y) * l1 + job.scales.y * dissimilar + job.scales.z * 3.0 * sums[3] / job.scales.x;
    values[1] = l1;
    values[2] = 1.0 - dissimilar;
    values[3] = sums[2] / job.scales.x;
}
