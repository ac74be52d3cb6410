// Sums over a workgroup's pixels by which a camera's exposure and clock are estimated (protocol.py, TrainingBackend.agreement).

//include common

struct Job {
    size: vec4u,   // pixels; whether there are weights, lower bounds, pictures of a little later and earlier
    limits: vec4f, // the alpha above which a pixel counts, the difference at which it counts half, the time between late and early
    gain: vec4f,
    bias: vec4f,
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> picture: array<f32>;
@group(0) @binding(2) var<storage, read> cover: array<f32>;
@group(0) @binding(3) var<storage, read> goal: array<f32>;
@group(0) @binding(4) var<storage, read> weights: array<f32>;
@group(0) @binding(5) var<storage, read> least: array<u32>;
@group(0) @binding(6) var<storage, read> late: array<f32>;
@group(0) @binding(7) var<storage, read> early: array<f32>;
@group(0) @binding(8) var<storage, read_write> sums: array<f32>;

const PIXELS = 128u;

var<workgroup> parts: array<f32, 2432>; // 19 numbers of each pixel, number by number

@compute @workgroup_size(128)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let block = place(group, groups);
    let pixel = block * PIXELS + lane;
    var found = array<f32, 19>();
    if pixel < job.size.x && cover[pixel] > job.limits.x {
        var count = 1.0;
        if job.size.y != 0u {
            count = min(weights[pixel], 1.0);
        }
        for (var c = 0u; c < 3u; c++) {
            let i = 3u * pixel + c;
            if job.size.z != 0u && least[i] != 0u {
                continue;
            }
            let p = picture[i];
            let q = goal[i] * job.gain[c] + job.bias[c];
            let rest = goal[i] - p;
            let far = rest / job.limits.y;
            let w = count / (1.0 + far * far);
            found[5u * c] = w;
            found[5u * c + 1u] = w * p;
            found[5u * c + 2u] = w * q;
            found[5u * c + 3u] = w * p * p;
            found[5u * c + 4u] = w * p * q;
            if job.size.w != 0u {
                let change = (late[i] - early[i]) / job.limits.z;
                found[15] += w * change * change;
                found[16] += w * change * rest;
                found[17] += w * rest * rest;
                found[18] += w;
            }
        }
    }
    for (var k = 0u; k < 19u; k++) {
        parts[k * PIXELS + lane] = found[k];
    }
    workgroupBarrier();
    if lane < 19u && block * PIXELS < job.size.x {
        var total = 0.0;
        for (var i = 0u; i < PIXELS; i++) {
            total += parts[lane * PIXELS + i];
        }
        sums[block * 19u + lane] = total;
    }
}
