// What a picture is compared with: the target, or, where that is only a lower bound, the picture if it is brighter.

//threads job.x

@group(0) @binding(0) var<uniform> job: vec4u; // numbers
@group(0) @binding(1) var<storage, read> picture: array<f32>;
@group(0) @binding(2) var<storage, read> bound: array<f32>;
@group(0) @binding(3) var<storage, read> least: array<u32>;
@group(0) @binding(4) var<storage, read_write> compared: array<f32>;

fn thread(i: u32) {
    compared[i] = select(bound[i], max(bound[i], picture[i]), least[i] != 0u);
}
