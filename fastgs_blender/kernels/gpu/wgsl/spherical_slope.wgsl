// Gradient by the direction of sum_b terms[b] Y_b (kernels/cpu/spherical.py, sh_slope).

fn sh_slope(degree: u32, d: vec3f) -> vec3f {
    let x = d.x;
    let y = d.y;
    let z = d.z;
    let xx = x * x;
    let yy = y * y;
    let zz = z * z;
    var g = vec3f(0.0);
    if degree > 0u {
        g = {SH_C1} * vec3f(-terms[3], -terms[1], terms[2]);
    }
    if degree > 1u {
        g += {SH_C2_0} * terms[4] * vec3f(y, x, 0.0);
        g += {SH_C2_1} * terms[5] * vec3f(0.0, z, y);
        g += {SH_C2_2} * terms[6] * vec3f(-2.0 * x, -2.0 * y, 4.0 * z);
        g += {SH_C2_3} * terms[7] * vec3f(z, 0.0, x);
        g += {SH_C2_4} * terms[8] * vec3f(2.0 * x, -2.0 * y, 0.0);
    }
    if degree > 2u {
        g += {SH_C3_0} * terms[9] * vec3f(6.0 * x * y, 3.0 * (xx - yy), 0.0);
        g += {SH_C3_1} * terms[10] * vec3f(y * z, x * z, x * y);
        g += {SH_C3_2} * terms[11] * vec3f(-2.0 * x * y, 4.0 * zz - xx - 3.0 * yy, 8.0 * y * z);
        g += {SH_C3_3} * terms[12] * vec3f(-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * xx - 3.0 * yy);
        g += {SH_C3_4} * terms[13] * vec3f(4.0 * zz - 3.0 * xx - yy, -2.0 * x * y, 8.0 * x * z);
        g += {SH_C3_5} * terms[14] * vec3f(2.0 * x * z, -2.0 * y * z, xx - yy);
        g += {SH_C3_6} * terms[15] * vec3f(3.0 * (xx - yy), -6.0 * x * y, 0.0);
    }
    if degree > 3u {
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
