// Add the gradient of the pull of features towards their targets (training/core/anchor.py), for the Gaussians that this step saw.  A target
// that is not finite means: this Gaussian has none.

//threads job.size.x

struct Job {
    size: vec4u, // numbers, columns
    strength: vec4f,
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> seen: array<f32>;
@group(0) @binding(2) var<storage, read> features: array<f32>;
@group(0) @binding(3) var<storage, read> goals: array<u32>;
@group(0) @binding(4) var<storage, read_write> gradient: array<f32>;

fn thread(i: u32) {
    let row = i / job.size.y;
    if seen[row] != 0.0 && (goals[row * job.size.y] & 0x7f800000u) != 0x7f800000u {
        gradient[i] += job.strength.x * (features[i] - bitcast<f32>(goals[i]));
    }
}
