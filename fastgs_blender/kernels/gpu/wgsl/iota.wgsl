// Fill an array with 0, 1, 2 ...

//threads length.x

@group(0) @binding(0) var<uniform> length: vec4u;
@group(0) @binding(1) var<storage, read_write> values: array<u32>;

fn thread(i: u32) {
    values[i] = i;
}
