// Radix sort, last stage of a pass: move every key and its value to its place; equal digits keep their order.
//
// A block's keys are first brought into the order of their digits within the workgroup, by four bits and then by the other four.  Those of a
// digit then lie together, so that they are written side by side, from where the digit begins for this block.

//include common

@group(0) @binding(0) var<uniform> job: vec4u; // keys, shift, blocks, digits of a row
@group(0) @binding(1) var<storage, read> before_block: array<u32>; // digit by digit, and of each block: keys before it in its row
@group(0) @binding(2) var<storage, read> totals: array<u32>; // keys of a row
@group(0) @binding(3) var<storage, read> keys: array<u32>;
@group(0) @binding(4) var<storage, read> values: array<u32>;
@group(0) @binding(5) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(6) var<storage, read_write> values_out: array<u32>;

var<workgroup> tally: array<u32, 1024>; // of each thread, how often each digit of four bits occurs: eight words of two digits
var<workgroup> slots: array<u32, 1024>; // the block's keys: their digits, and above 8 bits their places in the block
var<workgroup> begins: array<u32, 256>; // where a digit of four bits begins in the block; where a row begins

//include tally_before

fn arrange(lane: u32, shift: u32) {
    var own = array<u32, 8>();
    //each i 8
    own[i] = slots[lane * 8u + i];
    tally[i * 128u + lane] = 0u;
    //end
    //each i 8
    tally[((own[i] >> shift) & 15u) / 2u * 128u + lane] += 1u << (16u * ((own[i] >> shift) & 1u));
    //end
    workgroupBarrier();
    let before = tally_before(lane);
    if lane == 127u {
        var sum = 0u;
        //each i 8
        {
            let total = before[i] + tally[i * 128u + lane];
            begins[2u * i] = sum;
            begins[2u * i + 1u] = sum + (total & 0xffffu);
            sum += (total & 0xffffu) + (total >> 16u);
        }
        //end
    }
    workgroupBarrier();
    //each i 8
    tally[i * 128u + lane] = before[i];
    //end
    //each i 8
    {
        let digit = (own[i] >> shift) & 15u;
        let word = digit / 2u * 128u + lane;
        slots[begins[digit] + ((tally[word] >> (16u * (digit & 1u))) & 0xffffu)] = own[i];
        tally[word] += 1u << (16u * (digit & 1u));
    }
    //end
    workgroupBarrier();
}

@compute @workgroup_size(128)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let block = place(group, groups);
    let first = block * 1024u;
    let count = min(job.x, first + 1024u) - min(job.x, first);
    //each i 8
    {
        let at = lane * 8u + i;
        slots[at] = at << 8u | 255u; // what lies behind the last key stays there
        if at < count {
            slots[at] = at << 8u | ((keys[first + at] >> job.y) & 255u);
        }
    }
    //end
    arrange(lane, 0u);
    arrange(lane, 4u);

    tally[lane] = totals[2u * lane] + totals[2u * lane + 1u];
    workgroupBarrier();
    let earlier = tally_before(lane)[0];
    begins[2u * lane] = earlier;
    begins[2u * lane + 1u] = earlier + totals[2u * lane];
    workgroupBarrier();
    //each i 8
    {
        let at = i * 128u + lane;
        let digit = slots[at] & 255u;
        if at < count && (at == 0u || digit != (slots[max(at, 1u) - 1u] & 255u)) {
            tally[digit] = begins[digit / job.w] + before_block[digit * job.z + block] - at;
        }
    }
    //end
    workgroupBarrier();
    //each i 8
    {
        let at = i * 128u + lane;
        if at < count {
            let place = tally[slots[at] & 255u] + at;
            let from_place = first + (slots[at] >> 8u);
            keys_out[place] = keys[from_place];
            values_out[place] = values[from_place];
        }
    }
    //end
}
