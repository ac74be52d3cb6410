// The sRGB curve (rendering/colour.py).

fn to_linear(x: f32) -> f32 {
    let a: f32 = abs(x);
    if (a <= {SRGB_CUT}) {
        return sign(x) * (a / {SRGB_SLOPE});
    }
    return sign(x) * pow((a + {SRGB_OFFSET}) / (1.0 + {SRGB_OFFSET}), {SRGB_GAMMA});
}

fn to_srgb(x: f32) -> f32 {
    if (x <= {SRGB_LINEAR_CUT}) {
        return x * {SRGB_SLOPE};
    }
    return (1.0 + {SRGB_OFFSET}) * pow(x, 1.0 / {SRGB_GAMMA}) - {SRGB_OFFSET};
}
