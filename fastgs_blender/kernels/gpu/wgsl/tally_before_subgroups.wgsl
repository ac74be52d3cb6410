// tally_before.wgsl for devices whose subgroups are consecutive threads (subgroups.wgsl).

var<workgroup> totals: array<u32, 512>; // of each subgroup, at most 64, word by word

fn tally_before(lane: u32) -> array<u32, 8> {
    let size = subgroupAdd(1u);
    let own = lane / size;
    var before = array<u32, 8>();
    for (var word = 0u; word < 8u; word++) {
        let value = tally[word * 256u + lane];
        before[word] = subgroupExclusiveAdd(value);
        if lane % size == size - 1u {
            totals[word * 64u + own] = before[word] + value;
        }
    }
    workgroupBarrier();
    for (var word = 0u; word < 8u; word++) {
        for (var i = 0u; i < own; i++) {
            before[word] += totals[word * 64u + i];
        }
    }
    return before;
}
