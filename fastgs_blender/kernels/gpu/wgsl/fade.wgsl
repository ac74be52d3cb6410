// The factor by which alpha fades in over a band above the cut, 3 s^2 - 2 s^3, and its derivative by alpha.

const SMOOTH = {SMOOTH};

fn fade(alpha: f32, cut: f32) -> vec2f {
    let s = clamp((alpha - cut) * {PER_BAND}, 0.0, 1.0);
    return vec2f(s * s * (3.0 - 2.0 * s), 6.0 * (s - s * s) * {PER_BAND});
}
