// Prefix sums, last part: add to each block of 2048 values the total of the blocks before it.

//threads length.x

@group(0) @binding(0) var<uniform> length: vec4u;
@group(0) @binding(1) var<storage, read_write> values: array<u32>;
@group(0) @binding(2) var<storage, read> sums: array<u32>;

fn thread(i: u32) {
    let sum = values[i] + sums[i / 2048u];
    values[i] = select(sum, 0xffffffffu, sum < values[i]);
}
