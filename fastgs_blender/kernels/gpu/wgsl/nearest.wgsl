// The nearest depth of each pixel's points (cover.wgsl).

//threads job.x

@group(0) @binding(0) var<uniform> job: vec4u; // pixels
@group(0) @binding(1) var<storage, read> cover: array<f32>;
@group(0) @binding(2) var<storage, read_write> nearest: array<f32>;

fn thread(i: u32) {
    nearest[i] = cover[i * {SAMPLES}u];
}
