// Take a step of Adam (kernels/cpu/adam.py) for each parameter of the rows (Gaussians) that this step saw, or of all rows.  adam_count.wgsl
// counts the rows' steps afterwards.

//threads job.size.x

struct Job {
    size: vec4u,  // numbers, columns, whether all rows move, length of the table
    betas: vec4f, // beta1, beta2, 1 - beta1, 1 - beta2
    floor: vec4f, // added to the root of the second moment
    rates: array<vec4f, {RATES}>,
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> since: array<f32>; // steps_since.wgsl: 0 where a step did not see the row
@group(0) @binding(2) var<storage, read> count: array<i32>;
@group(0) @binding(3) var<storage, read> table: array<vec2f>; // corrections of the moments' bias by the row's step
@group(0) @binding(4) var<storage, read> gradient: array<f32>;
@group(0) @binding(5) var<storage, read_write> value: array<f32>;
@group(0) @binding(6) var<storage, read_write> mean: array<f32>;
@group(0) @binding(7) var<storage, read_write> square: array<f32>;
@group(0) @binding(8) var<storage, read> spilled: array<u32>; // a step that did not fit changes nothing (tiles_pad.wgsl)

fn thread(i: u32) {
    if spilled[0] != 0u {
        return;
    }
    let row = i / job.size.y;
    if job.size.z == 0u && since[row] == 0.0 {
        return;
    }
    let reach = select(sqrt(min(since[row], {LONGEST}.0)), 1.0, job.size.z != 0u);
    let column = i % job.size.y;
    let corrections = table[min(u32(count[row] + 1), job.size.w - 1u)];
    let g = select(0.0, gradient[i], abs(gradient[i]) <= 3e38);
    let m = job.betas.x * mean[i] + job.betas.z * g;
    let kept = select(0.0, m, abs(m) > 1e-30);
    let s = job.betas.y * square[i] + job.betas.w * g * g;
    mean[i] = kept;
    square[i] = s;
    value[i] -= job.rates[column / 4u][column % 4u] * reach * corrections.x * kept / (sqrt(s) * corrections.y + job.floor.x);
}
