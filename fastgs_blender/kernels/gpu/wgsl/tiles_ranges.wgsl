// Where each tile's list begins in `lists`, and after that the lists: the splat of each of the sorted entries.

//threads job.x + 1u

@group(0) @binding(0) var<uniform> job: vec4u; // entries, tiles
@group(0) @binding(1) var<storage, read> tiles: array<u32>;
@group(0) @binding(2) var<storage, read> values: array<u32>;
@group(0) @binding(3) var<storage, read> owner: array<u32>;
@group(0) @binding(4) var<storage, read_write> lists: array<u32>;

fn thread(e: u32) {
    var first = 0u;
    if e > 0u {
        first = tiles[e - 1u] + 1u;
    }
    var last = job.y;
    if e < job.x {
        last = tiles[e];
        lists[job.y + 1u + e] = owner[values[e]];
    }
    for (var tile = first; tile <= last; tile++) {
        lists[tile] = job.y + 1u + e;
    }
}
