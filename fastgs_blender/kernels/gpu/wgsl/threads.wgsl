// As many threads as a stage asks for in //threads COUNT, each of which does what thread(n) says.

//include common

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let n = place(group, groups) * 256u + lane;
    if n < COUNT {
        thread(n);
    }
}
