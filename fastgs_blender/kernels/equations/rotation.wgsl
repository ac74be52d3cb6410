// Rotations by quaternions w x y z (util/rotations.py).

fn unit_quaternion(q: vec4f) -> vec4f {
    let norm: f32 = length(q);
    if (norm > 1e-12) {
        return q / norm;
    }
    return vec4f(1.0, 0.0, 0.0, 0.0);
}

// The rotation matrix of a unit quaternion; its columns are the Gaussian's axes.
fn axes_of(q: vec4f) -> mat3x3f {
    let w: f32 = q.x;
    let v: vec3f = q.yzw;
    return mat3x3f(
        vec3f(1.0 - 2.0 * (v.y * v.y + v.z * v.z), 2.0 * (v.x * v.y + w * v.z), 2.0 * (v.x * v.z - w * v.y)),
        vec3f(2.0 * (v.x * v.y - w * v.z), 1.0 - 2.0 * (v.x * v.x + v.z * v.z), 2.0 * (v.y * v.z + w * v.x)),
        vec3f(2.0 * (v.x * v.z + w * v.y), 2.0 * (v.y * v.z - w * v.x), 1.0 - 2.0 * (v.x * v.x + v.y * v.y)));
}
