// Spherical harmonics (model/appearance.py, sh_basis): sh_terms() leaves the terms of a unit direction in `terms`.

var<private> terms: array<f32, 25>;

fn sh_terms(degree: i32, d: vec3f) {
    let x: f32 = d.x;
    let y: f32 = d.y;
    let z: f32 = d.z;
    let xx: f32 = x * x;
    let yy: f32 = y * y;
    let zz: f32 = z * z;
    terms[0] = {SH_C0};
    if (degree > 0) {
        terms[1] = -{SH_C1} * y;
        terms[2] = {SH_C1} * z;
        terms[3] = -{SH_C1} * x;
    }
    if (degree > 1) {
        terms[4] = {SH_C2_0} * x * y;
        terms[5] = {SH_C2_1} * y * z;
        terms[6] = {SH_C2_2} * (2.0 * zz - xx - yy);
        terms[7] = {SH_C2_3} * x * z;
        terms[8] = {SH_C2_4} * (xx - yy);
    }
    if (degree > 2) {
        terms[9] = {SH_C3_0} * y * (3.0 * xx - yy);
        terms[10] = {SH_C3_1} * x * y * z;
        terms[11] = {SH_C3_2} * y * (4.0 * zz - xx - yy);
        terms[12] = {SH_C3_3} * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
        terms[13] = {SH_C3_4} * x * (4.0 * zz - xx - yy);
        terms[14] = {SH_C3_5} * z * (xx - yy);
        terms[15] = {SH_C3_6} * x * (xx - 3.0 * yy);
    }
    if (degree > 3) {
        terms[16] = {SH_C4_0} * x * y * (xx - yy);
        terms[17] = {SH_C4_1} * y * z * (3.0 * xx - yy);
        terms[18] = {SH_C4_2} * x * y * (7.0 * zz - 1.0);
        terms[19] = {SH_C4_3} * y * z * (7.0 * zz - 3.0);
        terms[20] = {SH_C4_4} * (zz * (35.0 * zz - 30.0) + 3.0);
        terms[21] = {SH_C4_5} * x * z * (7.0 * zz - 3.0);
        terms[22] = {SH_C4_6} * (xx - yy) * (7.0 * zz - 1.0);
        terms[23] = {SH_C4_7} * x * z * (xx - 3.0 * yy);
        terms[24] = {SH_C4_8} * (xx * (xx - 3.0 * yy) - yy * (3.0 * xx - yy));
    }
}

//backward

// Gradient by the direction of sum_b terms[b] Y_b (kernels/cpu/spherical.py, sh_slope).

fn sh_slope(degree: i32, d: vec3f) -> vec3f {
    let x: f32 = d.x;
    let y: f32 = d.y;
    let z: f32 = d.z;
    let xx: f32 = x * x;
    let yy: f32 = y * y;
    let zz: f32 = z * z;
    var g: vec3f = vec3f(0.0);
    if (degree > 0) {
        g = {SH_C1} * vec3f(-terms[3], -terms[1], terms[2]);
    }
    if (degree > 1) {
        g += {SH_C2_0} * terms[4] * vec3f(y, x, 0.0);
        g += {SH_C2_1} * terms[5] * vec3f(0.0, z, y);
        g += {SH_C2_2} * terms[6] * vec3f(-2.0 * x, -2.0 * y, 4.0 * z);
        g += {SH_C2_3} * terms[7] * vec3f(z, 0.0, x);
        g += {SH_C2_4} * terms[8] * vec3f(2.0 * x, -2.0 * y, 0.0);
    }
    if (degree > 2) {
        g += {SH_C3_0} * terms[9] * vec3f(6.0 * x * y, 3.0 * (xx - yy), 0.0);
        g += {SH_C3_1} * terms[10] * vec3f(y * z, x * z, x * y);
        g += {SH_C3_2} * terms[11] * vec3f(-2.0 * x * y, 4.0 * zz - xx - 3.0 * yy, 8.0 * y * z);
        g += {SH_C3_3} * terms[12] * vec3f(-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * xx - 3.0 * yy);
        g += {SH_C3_4} * terms[13] * vec3f(4.0 * zz - 3.0 * xx - yy, -2.0 * x * y, 8.0 * x * z);
        g += {SH_C3_5} * terms[14] * vec3f(2.0 * x * z, -2.0 * y * z, xx - yy);
        g += {SH_C3_6} * terms[15] * vec3f(3.0 * (xx - yy), -6.0 * x * y, 0.0);
    }
    if (degree > 3) {
        g += {SH_C4_0} * terms[16] * vec3f(y * (3.0 * xx - yy), x * (xx - 3.0 * yy), 0.0);
        g += {SH_C4_1} * terms[17] * vec3f(6.0 * x * y * z, 3.0 * z * (xx - yy), y * (3.0 * xx - yy));
        g += {SH_C4_2} * terms[18] * vec3f(y * (7.0 * zz - 1.0), x * (7.0 * zz - 1.0), 14.0 * x * y * z);
        g += {SH_C4_3} * terms[19] * vec3f(0.0, z * (7.0 * zz - 3.0), y * (21.0 * zz - 3.0));
        g += {SH_C4_4} * terms[20] * vec3f(0.0, 0.0, z * (140.0 * zz - 60.0));
        g += {SH_C4_5} * terms[21] * vec3f(z * (7.0 * zz - 3.0), 0.0, x * (21.0 * zz - 3.0));
        g += {SH_C4_6} * terms[22] * vec3f(2.0 * x * (7.0 * zz - 1.0), -2.0 * y * (7.0 * zz - 1.0), 14.0 * z * (xx - yy));
        g += {SH_C4_7} * terms[23] * vec3f(3.0 * z * (xx - yy), -6.0 * x * y * z, x * (xx - 3.0 * yy));
        g += {SH_C4_8} * terms[24] * vec3f(4.0 * x * (xx - 3.0 * yy), 4.0 * y * (yy - 3.0 * xx), 0.0);
    }
    return g;
}
