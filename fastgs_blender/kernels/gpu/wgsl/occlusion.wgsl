// What triangles of a holdout do to a pixel (kernels/cpu/occlusion.py): its points lose their shares of the light, each at its depth.
// `cover` holds these depths (cover.wgsl), POINTS a pixel, the nearest first; FARTHEST stands for a point that nothing covers.

const HOLDOUT = {HOLDOUT};
const POINTS = {SAMPLES}u;
const FARTHEST = {FARTHEST};

var<private> taken = 0u;    // points that have lost their light
var<private> stopped = 0.0; // light that triangles have stopped
var<private> caught = 0.0;  // light that splats have: exactly none where there are none, which 1 - t - stopped is not where a GPU divides roughly

// Depth behind which triangles hide the whole pixel.
fn farthest_cover(pixel: u32, inside: bool) -> f32 {
    if HOLDOUT && inside {
        return cover[pixel * POINTS + POINTS - 1u];
    }
    return FARTHEST;
}

// The transmittance behind the triangles that lie before a depth.
fn uncovered(before: f32, pixel: u32, depth: f32) -> f32 {
    var left = before;
    while taken < POINTS && cover[pixel * POINTS + taken] < depth {
        let after = left * f32(POINTS - taken - 1u) / f32(POINTS - taken);
        stopped += left - after;
        left = after;
        taken++;
    }
    return left;
}

// Depth of a splat's plane (oracle.plane) at a place, counted from the image's middle; first: of the plane's three channels.
fn plane_depth(first: u32, place: vec2f) -> f32 {
    return number(first) + number(first + 1u) * place.x + number(first + 2u) * place.y;
}

fn number(at: u32) -> f32 {
    return channels[at / 4u][at % 4u];
}
