// Move nearly transparent Gaussians at random, each in its own shape (MCMC).  The random numbers are PCG's of the row and the key, made
// normal after Box and Muller.

//threads job.size.x
//include rotation

struct Job {
    size: vec4u, // rows, key, key, the first one's number
    reach: vec4f, // reach, gate, sharpness, the least share that counts
    frozen: vec4u, // how many, the first ones, stay as they are
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> opacity: array<f32>;
@group(0) @binding(2) var<storage, read> rotation: array<f32>;
@group(0) @binding(3) var<storage, read> scale: array<f32>;
@group(0) @binding(4) var<storage, read_write> position: array<f32>;
@group(0) @binding(5) var<storage, read> spilled: array<u32>; // not 0: the step has to be taken again

fn pcg(x: u32) -> u32 {
    let state = x * 747796405u + 2891336453u;
    let word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}

fn thread(row: u32) {
    if spilled[0] != 0u || job.size.w + row < job.frozen.x {
        return;
    }
    let o = 1.0 / (1.0 + exp(-opacity[row]));
    let gate = 1.0 / (1.0 + exp(-job.reach.z * ((1.0 - o) - job.reach.y)));
    if !(gate > job.reach.w) {
        return;
    }
    var normal: vec3f;
    var random = pcg(pcg((job.size.w + row) ^ job.size.y) + job.size.z);
    for (var i = 0u; i < 3u; i++) {
        random = pcg(random);
        let radius = sqrt(-2.0 * log((f32(random >> 8u) + 1.0) / 16777216.0));
        random = pcg(random);
        normal[i] = radius * cos(6.283185307179586 * f32(random >> 8u) / 16777216.0);
    }
    let axes = axes_of(unit_quaternion(vec4f(rotation[4u * row], rotation[4u * row + 1u], rotation[4u * row + 2u], rotation[4u * row + 3u])));
    let size = exp(vec3f(scale[3u * row], scale[3u * row + 1u], scale[3u * row + 2u]));
    let step = axes * (size * size * ((gate * job.reach.x * normal) * axes));
    for (var i = 0u; i < 3u; i++) {
        position[3u * row + i] += step[i];
    }
}
