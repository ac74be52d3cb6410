// A splat's weights in four channels: in those from CORE to END its weight in the core of the pixel (rendering/layout.py).

const CORE = {CORE}u;
const END = {END}u;

fn weights(quad: u32, before: f32, weight: f32) -> vec4f {
    if END == 0u {
        return vec4f(weight);
    }
    let inner = max(min(before, {CORE_TO}) - max(before - weight, {CORE_FROM}), 0.0) + {REST} * weight;
    let channel = 4u * quad + vec4u(0u, 1u, 2u, 3u);
    return select(vec4f(weight), vec4f(inner), (channel >= vec4u(CORE)) & (channel < vec4u(END)));
}
