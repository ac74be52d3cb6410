// Write the number of this step for each row (Gaussian) that this step saw: the last step in which it was updated.

//threads job.x

@group(0) @binding(0) var<uniform> job: vec4u; // rows, step
@group(0) @binding(1) var<storage, read> seen: array<f32>;
@group(0) @binding(2) var<storage, read_write> moved: array<i32>;
@group(0) @binding(3) var<storage, read> spilled: array<u32>;

fn thread(row: u32) {
    if spilled[0] == 0u && seen[row] != 0.0 {
        moved[row] = i32(job.y);
    }
}
