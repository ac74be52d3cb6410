// Whether the subgroups of a workgroup are whole, of at least four threads, and made of consecutive threads in their order, which WebGPU
// does not promise.

@group(0) @binding(0) var<uniform> unused: vec4u;
@group(0) @binding(1) var<storage, read_write> orderly: array<u32>; // of each thread: unused + 1 if so

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) lane: u32) {
    let size = subgroupAdd(1u);
    let place = subgroupExclusiveAdd(1u);
    let first = subgroupBroadcastFirst(lane);
    orderly[lane] = unused.x + u32(size >= 4u && 256u % size == 0u && place == lane % size && first == lane - place);
}
