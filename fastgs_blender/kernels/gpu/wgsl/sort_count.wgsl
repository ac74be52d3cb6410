// Radix sort, first half of a pass: count how often each digit of 4 bits occurs in each block of 2048 keys.  The counts lie digit by digit.

//include common

@group(0) @binding(0) var<uniform> job: vec4u; // keys, shift, blocks
@group(0) @binding(1) var<storage, read> keys: array<u32>;
@group(0) @binding(2) var<storage, read_write> counts: array<u32>;

var<workgroup> tally: array<atomic<u32>, 16>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let block = place(group, groups);
    if lane < 16u {
        atomicStore(&tally[lane], 0u);
    }
    workgroupBarrier();
    for (var i = 0u; i < 8u; i++) {
        let at = block * 2048u + i * 256u + lane;
        if at < job.x {
            atomicAdd(&tally[(keys[at] >> job.y) & 15u], 1u);
        }
    }
    workgroupBarrier();
    if lane < 16u && block < job.z {
        counts[lane * job.z + block] = atomicLoad(&tally[lane]);
    }
}
