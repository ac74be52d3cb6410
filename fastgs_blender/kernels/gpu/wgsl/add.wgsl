// Add a range of an array to a range of another array, element by element.

//threads job.x

@group(0) @binding(0) var<uniform> job: vec4u; // how many, place of the first among those that are added, and among the sums
@group(0) @binding(1) var<storage, read> values: array<f32>;
@group(0) @binding(2) var<storage, read_write> sums: array<f32>;

fn thread(i: u32) {
    sums[job.z + i] += values[job.y + i];
}
