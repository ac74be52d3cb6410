// Add one view to the statistics of density control (training/core/statistics.py): the gradients of the splats' positions on the screen.

//threads job.size.x

struct Job {
    size: vec4u,  // Gaussians
    half: vec4f,  // half the image's width and height
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> depths: array<u32>;
@group(0) @binding(2) var<storage, read> splat_a: array<vec4f>;
@group(0) @binding(3) var<storage, read> splat_b: array<vec4f>;
@group(0) @binding(4) var<storage, read> sums: array<vec4f>;
@group(0) @binding(5) var<storage, read_write> gradient: array<f32>;
@group(0) @binding(6) var<storage, read_write> absolute: array<f32>;
@group(0) @binding(7) var<storage, read> spilled: array<u32>;

fn thread(n: u32) {
    if depths[n] == 0xffffffffu || spilled[0] != 0u {
        return;
    }
    let a = splat_a[n];
    let b = splat_b[n];
    let first = sums[n * ({QUADS}u + 2u)];
    let second = sums[n * ({QUADS}u + 2u) + 1u];
    let mean = vec2f(a.z * first.y, a.w * first.y + b.x * b.x * second.x);
    gradient[n] += 1.3862943611198906 * length(mean * job.half.xy);
    absolute[n] += 1.3862943611198906 * length(vec2f(a.z * second.z, second.w) * job.half.xy);
}
