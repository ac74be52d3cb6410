// Looks of colour (rendering/looks.py, graded): `look` is what look_numbers() gives.

fn graded(colour: vec3f) -> vec3f {
    let linear = look_at({LOOK_LINEAR}u) != 0.0;
    let given = select(vec3f(to_linear(colour.x), to_linear(colour.y), to_linear(colour.z)), colour, linear);
    var out = vec3f(0.0);
    for (var row = 0u; row < 3u; row++) {
        let at = {LOOK_MATRIX}u + 3u * row;
        let x = max(dot(vec3f(look_at(at), look_at(at + 1u), look_at(at + 2u)), given), 0.0);
        let powered = look_at({LOOK_FACTOR}u) * select(pow(x, look_at({LOOK_POWER}u)), select(0.0, 1.0, look_at({LOOK_POWER}u) == 0.0), x == 0.0);
        out[row] = select(to_srgb(powered), powered, linear);
    }
    return out;
}
