// Exclusive prefix sums within rows of numbers, in place in `values`; `sums` gets each row's total.  Sums that do not fit into 32 bits stay at
// the largest number.

//include common

@group(0) @binding(0) var<uniform> length: vec4u; // numbers, those of a row
@group(0) @binding(1) var<storage, read_write> values: array<u32>;
@group(0) @binding(2) var<storage, read_write> sums: array<u32>;

var<workgroup> own: array<u32, 256>;
var<workgroup> sixteen: array<u32, 16>;
var<workgroup> done: u32; // the sum of the row's earlier numbers

fn plus(a: u32, b: u32) -> u32 {
    return select(a + b, 0xffffffffu, a + b < a);
}

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let number = place(group, groups);
    let end = min((number + 1u) * length.y, length.x);
    if lane == 0u {
        done = 0u;
    }
    for (var block = number * length.y; block < end; block += 2048u) {
        let first = block + lane * 8u;
        let last = min(first + 8u, end);
        var total = 0u;
        for (var i = first; i < last; i++) {
            total = plus(total, values[i]);
        }
        own[lane] = total;
        workgroupBarrier();
        if lane < 16u {
            var sum = 0u;
            for (var i = 16u * lane; i < 16u * lane + 16u; i++) {
                sum = plus(sum, own[i]);
            }
            sixteen[lane] = sum;
        }
        workgroupBarrier();
        var before = done;
        for (var i = 0u; i < lane / 16u; i++) {
            before = plus(before, sixteen[i]);
        }
        for (var i = lane / 16u * 16u; i < lane; i++) {
            before = plus(before, own[i]);
        }
        workgroupBarrier();
        if lane == 255u {
            done = plus(before, total);
        }
        for (var i = first; i < last; i++) {
            let value = values[i];
            values[i] = before;
            before = plus(before, value);
        }
    }
    if lane == 255u && number * length.y < length.x {
        sums[number] = done;
    }
}
