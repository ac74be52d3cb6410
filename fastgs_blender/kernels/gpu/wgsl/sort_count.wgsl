// Radix sort, first stage of a pass: count how often each digit of 8 bits occurs in each block of 1024 keys.  The counts lie digit by digit.

//include common

@group(0) @binding(0) var<uniform> job: vec4u; // keys, shift, blocks
@group(0) @binding(1) var<storage, read> keys: array<u32>;
@group(0) @binding(2) var<storage, read_write> counts: array<u32>;

var<workgroup> tally: array<atomic<u32>, 256>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let block = place(group, groups);
    atomicStore(&tally[lane], 0u);
    workgroupBarrier();
    //each i 4
    {
        let at = block * 1024u + i * 256u + lane;
        if at < job.x {
            atomicAdd(&tally[(keys[at] >> job.y) & 255u], 1u);
        }
    }
    //end
    workgroupBarrier();
    if block < job.z {
        counts[lane * job.z + block] = atomicLoad(&tally[lane]);
    }
}
