// What a Gaussian adds to a picture (model/appearance.py, seen): the numbers of a colour, or a decoder's features.

fn appearance_numbers() -> u32 {
    return select(3u, 9u, view.kinds.y == FEATURES);
}

// The colour of spherical harmonics before it is cut off at 0; their terms stay in `terms`.
fn harmonics(n: u32, delta: f32, along: vec3f) -> vec3f {
    sh_terms(i32(view.kinds.z), along / max(length(along), 1e-30));
    var colour = vec3f(0.5);
    for (var b = 0u; b < (view.kinds.z + 1u) * (view.kinds.z + 1u); b++) {
        colour += terms[b] * vec3f(feature(n, 3u * b, delta), feature(n, 3u * b + 1u, delta), feature(n, 3u * b + 2u, delta));
    }
    return colour;
}

fn appear(n: u32, delta: f32, position: vec3f) -> array<f32, 9> {
    var out = array<f32, 9>();
    if view.kinds.y == SH {
        let colour = max(harmonics(n, delta, seen_along(position)), vec3f(0.0));
        for (var c = 0u; c < 3u; c++) {
            out[c] = colour[c];
        }
    } else {
        for (var c = 0u; c < appearance_numbers(); c++) {
            out[c] = feature(n, c, delta) * select(1.0, delta, c >= 6u);
        }
    }
    return out;
}

//backward

// From the gradient g of what appear() gave to that of the features; returns those of the position, and of delta.
fn appear_backward(n: u32, delta: f32, position: vec3f, g: array<f32, 9>) -> vec4f {
    var by = g;
    var found = vec4f(0.0);
    if view.kinds.y == SH {
        let along = seen_along(position);
        let distance = max(length(along), 1e-30);
        let d = along / distance;
        let light = select(vec3f(0.0), vec3f(g[0], g[1], g[2]), harmonics(n, delta, along) > vec3f(0.0));
        for (var k = 0u; k < (view.kinds.z + 1u) * (view.kinds.z + 1u); k++) {
            let value = terms[k];
            terms[k] = 0.0;
            for (var i = 0u; i < 3u; i++) {
                terms[k] += light[i] * feature(n, 3u * k + i, delta);
                found.w += spread_feature(n, 3u * k + i, delta, value * light[i]);
            }
        }
        let h = sh_slope(i32(view.kinds.z), d);
        return vec4f((h - dot(h, d) * d) / distance, found.w);
    }
    for (var c = 0u; c < appearance_numbers(); c++) {
        if c >= 6u {
            found.w += by[c] * feature(n, c, delta);
        }
        found.w += spread_feature(n, c, delta, by[c] * select(1.0, delta, c >= 6u));
    }
    return found;
}
