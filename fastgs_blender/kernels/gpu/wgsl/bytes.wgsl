// A picture's bytes, four to a word, as numbers: 255 is 1.

//include common

@group(0) @binding(0) var<uniform> job: vec4u; // bytes
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(2) var<storage, read_write> values: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = place(group, groups) * 256u + lane;
    if i < job.x {
        values[i] = f32((words[i / 4u] >> (8u * (i % 4u))) & 255u) / 255.0;
    }
}
