// Radix sort, second half of a pass: move every key and its value to its place; equal digits keep their order.
//
// Each thread handles eight consecutive keys.  `tally` counts each thread's digits, two digits to a word.  A key's place is the place at
// which its digit begins for this block (`starts`), plus the number of keys of that digit before it: the sum of earlier threads' tallies.

//include common

@group(0) @binding(0) var<uniform> job: vec4u; // keys, shift, blocks
@group(0) @binding(1) var<storage, read> starts: array<u32>;
@group(0) @binding(2) var<storage, read> keys: array<u32>;
@group(0) @binding(3) var<storage, read> values: array<u32>;
@group(0) @binding(4) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(5) var<storage, read_write> values_out: array<u32>;

var<workgroup> tally: array<u32, 2048>;

//include tally_before

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let block = place(group, groups);
    let first = block * 2048u + lane * 8u;
    let last = min(first + 8u, job.x);
    for (var word = 0u; word < 8u; word++) {
        tally[word * 256u + lane] = 0u;
    }
    for (var i = first; i < last; i++) {
        let digit = (keys[i] >> job.y) & 15u;
        tally[digit / 2u * 256u + lane] += 1u << (16u * (digit & 1u));
    }
    workgroupBarrier();
    var before = tally_before(lane);
    workgroupBarrier();
    for (var word = 0u; word < 8u; word++) {
        tally[word * 256u + lane] = before[word];
    }
    for (var i = first; i < last; i++) {
        let key = keys[i];
        let digit = (key >> job.y) & 15u;
        let word = digit / 2u * 256u + lane;
        let shift = 16u * (digit & 1u);
        let at = starts[digit * job.z + block] + ((tally[word] >> shift) & 0xffffu);
        tally[word] += 1u << shift;
        keys_out[at] = key;
        values_out[at] = values[i];
    }
}
