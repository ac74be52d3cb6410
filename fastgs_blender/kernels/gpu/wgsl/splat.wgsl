// A splat at a pixel, d from its centre: log2(alpha) = log2(opacity) - u^2 - v^2, as project.wgsl writes a and b.

fn along_axes(d: vec2f, a: vec4f, b: vec4f) -> vec2f {
    return vec2f(a.z * d.x + a.w * d.y, b.x * d.y);
}

fn log2_alpha(uv: vec2f, b: vec4f) -> f32 {
    return b.y - uv.y * uv.y - uv.x * uv.x;
}
