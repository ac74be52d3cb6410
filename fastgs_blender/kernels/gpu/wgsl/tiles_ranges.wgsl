// Where each tile's list begins in `lists`, and after that the lists: the splat of each of the sorted entries.

//include common

@group(0) @binding(0) var<uniform> job: vec4u; // entries, tiles
@group(0) @binding(1) var<storage, read> tiles: array<u32>;
@group(0) @binding(2) var<storage, read> values: array<u32>;
@group(0) @binding(3) var<storage, read> owner: array<u32>;
@group(0) @binding(4) var<storage, read_write> lists: array<u32>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let e = place(group, groups) * 256u + lane;
    if e > job.x {
        return;
    }
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
