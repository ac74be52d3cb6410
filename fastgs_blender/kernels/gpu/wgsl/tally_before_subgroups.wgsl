// tally_before.wgsl for devices whose subgroups are consecutive threads (subgroups.wgsl).

var<workgroup> sums: array<u32, 256>; // of each subgroup, at most 32, word by word

fn tally_before(lane: u32) -> array<u32, 8> {
    let size = subgroupAdd(1u);
    let own = lane / size;
    var before = array<u32, 8>();
    for (var word = 0u; word < 8u; word++) {
        let value = tally[word * 128u + lane];
        before[word] = subgroupExclusiveAdd(value);
        if lane % size == size - 1u {
            sums[word * 32u + own] = before[word] + value;
        }
    }
    workgroupBarrier();
    for (var word = 0u; word < 8u; word++) {
        for (var i = 0u; i < own; i++) {
            before[word] += sums[word * 32u + i];
        }
    }
    return before;
}
