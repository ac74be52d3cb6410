// The sums of earlier threads' tallies, of each of the eight words (sort_scatter.wgsl).

var<workgroup> sixteen: array<u32, 64>;

fn tally_before(lane: u32) -> array<u32, 8> {
    if lane < 64u {
        var sum = 0u;
        for (var i = 0u; i < 16u; i++) {
            sum += tally[16u * lane + i];
        }
        sixteen[lane] = sum;
    }
    workgroupBarrier();
    var before = array<u32, 8>();
    for (var word = 0u; word < 8u; word++) {
        var sum = 0u;
        for (var i = 0u; i < lane / 16u; i++) {
            sum += sixteen[8u * word + i];
        }
        for (var i = lane / 16u * 16u; i < lane; i++) {
            sum += tally[word * 128u + i];
        }
        before[word] = sum;
    }
    return before;
}
