// Add 1 to the number of Adam steps of each row that adam.wgsl has updated.

//threads job.x

@group(0) @binding(0) var<uniform> job: vec4u; // rows, whether all have moved
@group(0) @binding(1) var<storage, read> seen: array<f32>;
@group(0) @binding(2) var<storage, read_write> count: array<i32>;
@group(0) @binding(3) var<storage, read> spilled: array<u32>;

fn thread(row: u32) {
    if spilled[0] == 0u && (job.y != 0u || seen[row] != 0.0) {
        count[row] += 1;
    }
}
