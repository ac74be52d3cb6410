// Copy rows of a piece of the splats, in the order of depth, to those that have a place, one after the other, as far as
// there is room.

//threads job.x

@group(0) @binding(0) var<uniform> job: vec4u; // splats, first row of the piece, its rows, numbers of a row
@group(0) @binding(1) var<storage, read> order: array<u32>;
@group(0) @binding(2) var<storage, read> places: array<u32>; // what has a place has another one than the next
@group(0) @binding(3) var<storage, read> values: array<u32>;
@group(0) @binding(4) var<storage, read_write> copies: array<u32>;

fn thread(k: u32) {
    if places[k] == places[k + 1u] {
        return;
    }
    let row = order[k] - job.y;
    if row >= job.z || (places[k] + 1u) * job.w > arrayLength(&copies) {
        return;
    }
    for (var c = 0u; c < job.w; c++) {
        copies[places[k] * job.w + c] = values[row * job.w + c];
    }
}
