// rendering/distance.py, Sampling.blurs() of one Gaussian: the blur, and the one whose share of opacity is kept.
//
// size: of a pixel at its depth; ball: around the cameras; sampling: coarse, least, reach, zoom.  A shader has captured(source, k)
// before this: the texels k = 2 i and 2 i + 1 of camera i, place and 1 / focal length, axis and the tangent of its view.

fn blurs(source: vec2i, cameras: i32, blur: f32, size: f32, fades: bool, ball: vec4f, sampling: vec4f, position: vec3f, largest: f32) -> vec2f {
    var found: f32 = max(sampling.y, sampling.x * (ball.w + length(position - ball.xyz)));
    let here: f32 = max(min(found, sampling.w * size), sampling.y);
    for (var i: i32 = 0; i < cameras && found > here; i++) {
        let place: vec4f = captured(source, 2 * i);
        let axis: vec4f = captured(source, 2 * i + 1);
        let away: vec3f = position - place.xyz;
        let along: f32 = dot(away, axis.xyz);
        let close: f32 = abs(along) * place.w;
        if (close < found) {
            let r: f32 = sqrt(max(dot(away, away) - along * along, 0.0));
            found = min(found, close + {STEEP} * max((r - sampling.z * largest) * axis.w - along, 0.0) * place.w);
        }
    }
    let ratio: f32 = max(found, here) / size;
    let finer: f32 = max(ratio / {MARGIN}, 1.0);
    var shrunk: f32 = 1.0;
    if (fades) {
        shrunk = min(ratio * {MARGIN}, 1.0);
    }
    let small: f32 = blur * finer * finer * shrunk * shrunk;
    return vec2f(small + min({BOX}, blur) * (1.0 - shrunk * shrunk), small);
}
