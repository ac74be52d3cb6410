// The number of the thread, or of the workgroup, in a dispatch that may be laid out in two dimensions (device.py, WIDEST).

fn place(own: vec3u, size: vec3u) -> u32 {
    return own.x + own.y * size.x;
}
