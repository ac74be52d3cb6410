// The sRGB curve (rendering/colour.py).

fn to_linear(x: f32) -> f32 {
    let a = abs(x);
    return sign(x) * select(pow((a + {SRGB_OFFSET}) / (1.0 + {SRGB_OFFSET}), {SRGB_GAMMA}), a / {SRGB_SLOPE}, a <= {SRGB_CUT});
}

fn to_srgb(x: f32) -> f32 {
    return select((1.0 + {SRGB_OFFSET}) * pow(x, 1.0 / {SRGB_GAMMA}) - {SRGB_OFFSET}, x * {SRGB_SLOPE}, x <= {SRGB_LINEAR_CUT});
}
