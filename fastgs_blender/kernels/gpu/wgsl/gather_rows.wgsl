// The numbers of the rows that gather.wgsl copies.  Where there is room for more, the rest is not drawn; checks the room, if it was guessed.

//threads job.x

@group(0) @binding(0) var<uniform> job: vec4u; // splats, room
@group(0) @binding(1) var<storage, read> order: array<u32>;
@group(0) @binding(2) var<storage, read> places: array<u32>;
@group(0) @binding(3) var<storage, read_write> rows: array<u32>;
@group(0) @binding(4) var<storage, read_write> depths: array<u32>; // of the copies
@group(0) @binding(5) var<storage, read_write> longest: array<u32>;
@group(0) @binding(6) var<storage, read_write> spilled: array<u32>;

//include guessed

fn thread(k: u32) {
    let number = places[job.x];
    if k == 0u {
        check(number, job.y);
    }
    if places[k] != places[k + 1u] && places[k] < job.y {
        rows[places[k]] = order[k];
    }
    if k >= number && k < job.y {
        depths[k] = 0xffffffffu;
    }
}
