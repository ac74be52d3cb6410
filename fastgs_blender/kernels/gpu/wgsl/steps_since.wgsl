// For each row (Gaussian) that this step sees, the number of steps since its last update; 0 for all others.

//threads job.x

@group(0) @binding(0) var<uniform> job: vec4u; // rows, step
@group(0) @binding(1) var<storage, read> seen: array<f32>;
@group(0) @binding(2) var<storage, read> moved: array<i32>;
@group(0) @binding(3) var<storage, read_write> since: array<f32>;

fn thread(row: u32) {
    since[row] = select(0.0, f32(i32(job.y) - moved[row]), seen[row] != 0.0);
}
