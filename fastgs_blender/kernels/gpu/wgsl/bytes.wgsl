// A picture's bytes, four to a word, as numbers: 255 is 1.

//threads job.x

@group(0) @binding(0) var<uniform> job: vec4u; // bytes
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(2) var<storage, read_write> values: array<f32>;

fn thread(i: u32) {
    values[i] = f32((words[i / 4u] >> (8u * (i % 4u))) & 255u) / 255.0;
}
