// Add one view to the statistics of density control: the number of views that showed a Gaussian, and its largest radius on the screen.

//threads job.size.x

struct Job {
    size: vec4u,    // Gaussians
    longest: vec4f, // the image's longer side
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> depths: array<u32>;
@group(0) @binding(2) var<storage, read> splat_a: array<vec4f>;
@group(0) @binding(3) var<storage, read> splat_b: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> seen: array<f32>;
@group(0) @binding(5) var<storage, read_write> radius: array<f32>;
@group(0) @binding(6) var<storage, read> spilled: array<u32>;

fn thread(n: u32) {
    if depths[n] == 0xffffffffu || spilled[0] != 0u {
        return;
    }
    let a = splat_a[n];
    let b = splat_b[n];
    let reach = sqrt(max(b.y - b.w, 0.0)) / b.x * max(length(vec2f(b.x, a.w)) / a.z, 1.0);
    seen[n] += 1.0;
    radius[n] = max(radius[n], (reach + 1e-3) / job.longest.x);
}
