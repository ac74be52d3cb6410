// Spherical harmonics (model/appearance.py, sh_basis): sh_terms() leaves the terms of a unit direction in `terms`.

var<private> terms: array<f32, 25>;

fn sh_terms(degree: u32, d: vec3f) {
    let x = d.x;
    let y = d.y;
    let z = d.z;
    let xx = x * x;
    let yy = y * y;
    let zz = z * z;
    terms[0] = {SH_C0};
    if degree > 0u {
        terms[1] = -{SH_C1} * y;
        terms[2] = {SH_C1} * z;
        terms[3] = -{SH_C1} * x;
    }
    if degree > 1u {
        terms[4] = {SH_C2_0} * x * y;
        terms[5] = {SH_C2_1} * y * z;
        terms[6] = {SH_C2_2} * (2.0 * zz - xx - yy);
        terms[7] = {SH_C2_3} * x * z;
        terms[8] = {SH_C2_4} * (xx - yy);
    }
    if degree > 2u {
        terms[9] = {SH_C3_0} * y * (3.0 * xx - yy);
        terms[10] = {SH_C3_1} * x * y * z;
        terms[11] = {SH_C3_2} * y * (4.0 * zz - xx - yy);
        terms[12] = {SH_C3_3} * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
        terms[13] = {SH_C3_4} * x * (4.0 * zz - xx - yy);
        terms[14] = {SH_C3_5} * z * (xx - yy);
        terms[15] = {SH_C3_6} * x * (xx - 3.0 * yy);
    }
    if degree > 3u {
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
