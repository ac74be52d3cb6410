// The factor by which crops multiply the opacity at a position (rendering/crops.py).  `extra` holds 16 numbers for each crop: the rows of
// its matrix, whether it removes, its kind, the width of its soft edge.  Crops that keep come before crops that remove.

fn crop_share(p: vec3f) -> f32 {
    let first = 2u * (view.terms.x + view.terms.y + view.terms.z);
    var share = select(0.0, 1.0, extra[first + 12u] != 0.0);
    for (var b = 0u; b < view.terms.w; b++) {
        let at = first + 16u * b;
        let removes = extra[at + 12u] != 0.0;
        let kind = u32(extra[at + 13u]);
        let soft = extra[at + 14u];
        let q = vec3f(
            extra[at] * p.x + extra[at + 1u] * p.y + extra[at + 2u] * p.z + extra[at + 3u],
            extra[at + 4u] * p.x + extra[at + 5u] * p.y + extra[at + 6u] * p.z + extra[at + 7u],
            extra[at + 8u] * p.x + extra[at + 9u] * p.y + extra[at + 10u] * p.z + extra[at + 11u]);
        let within = all(abs(q) <= vec3f(1.0));
        var depth = -1.0;
        if kind == {SPHERE}u {
            depth = 1.0 - length(q);
        } else if within && kind >= {VOLUME}u {
            depth = volume_depth(kind - {VOLUME}u, q);
        } else if within {
            depth = 1.0 - max(max(abs(q.x), abs(q.y)), abs(q.z));
        }
        if !(depth >= 0.0) {
            continue;
        }
        var inside = 1.0;
        if depth < soft {
            let s = depth / soft;
            inside = s * s * (3.0 - 2.0 * s);
        }
        if removes {
            share *= 1.0 - inside;
        } else {
            share = max(share, inside);
        }
    }
    return share;
}

// volumes.Volume.depth_at, between the eight nodes around a place.
fn volume_depth(number: u32, q: vec3f) -> f32 {
    let side = view.flags.y;
    let last = f32(side - 1u);
    let place = (q + 1.0) * 0.5 * last;
    let low = min(vec3u(place), vec3u(side - 2u));
    let f = place - vec3f(low);
    var depth = 0.0;
    for (var corner = 0u; corner < 8u; corner++) {
        let far = vec3u(corner >> 2u, (corner >> 1u) & 1u, corner & 1u);
        let shares = select(1.0 - f, f, far == vec3u(1u));
        let node = low + far;
        depth += shares.x * shares.y * shares.z * extra[view.flags.z + ((number * side + node.x) * side + node.y) * side + node.z];
    }
    return depth;
}
