// The tile of a pixel of the window, counted from the window's first one.

fn tile_of(pixel: u32) -> u32 {
    let at = job.window.xy + vec2u(pixel % job.size.z, pixel / job.size.z);
    return at.y / {TILE}u * job.window.z + at.x / {TILE}u;
}
