// Write 1 for each Gaussian that the view draws, for the optimiser.

//threads job.x

@group(0) @binding(0) var<uniform> job: vec4u; // Gaussians
@group(0) @binding(1) var<storage, read> depths: array<u32>;
@group(0) @binding(2) var<storage, read_write> seen: array<f32>;

fn thread(n: u32) {
    if depths[n] != 0xffffffffu {
        seen[n] = 1.0;
    }
}
