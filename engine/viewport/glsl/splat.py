# SPDX-License-Identifier: GPL-3.0-or-later
"""The shaders that slice, project and blend splats: one instance of a rectangle for each Gaussian."""
from __future__ import annotations

from . import constants, grade

FETCH = """
int whole(float x) { return int(floor(x + 0.5)); }
vec4 view_texel(int j) { return texelFetch(t_table, ivec2(j, 0), 0); }
vec4 instance_texel(int o, int j) { return texelFetch(t_table, ivec2(j, o + 1), 0); }
vec4 geometry_texel(int i) { return texelFetch(t_geometry, ivec2(i % WIDTH, i / WIDTH), 0); }
vec4 colour_texel(int i) { return texelFetch(t_colour, ivec2(i % WIDTH, i / WIDTH), 0); }
"""

SLICE = """
/* place of an instance's first Gaussian among those of all instances */
int first_of(int o) {
  return whole(instance_texel(o, INSTANCE_GROUP).w) * WIDTH + whole(instance_texel(o, INSTANCE_FIRST).x);
}

/* the instance that Gaussian g belongs to */
int instance_of(int g, int instances) {
  int low = 0;
  int high = instances;
  while (high - low > 1) {
    int middle = (low + high) / 2;
    if (first_of(middle) <= g) { low = middle; } else { high = middle; }
  }
  return low;
}

/* temporal.py: the factor of each kind of temporal opacity */
float temporal_factor(int kind, float t, float mu_tau, vec4 p) {
  if (kind == TEMPORAL_RADIAL) {
    float d = t - mu_tau;
    return exp(-exp(p.x) * d * d);
  }
  if (kind == TEMPORAL_WINDOW) {
    float early = max(p.x - t, 0.0) / exp(p.z);
    float late = max(t - p.y, 0.0) / exp(p.w);
    return exp(-early * early - late * late);
  }
  if (kind == TEMPORAL_RADIAL_WINDOW) {
    float d = t - mu_tau;
    float outside = max(max(p.y - t, t - p.z), 0.0) / exp(p.w);
    return exp(-exp(p.x) * d * d - outside * outside);
  }
  return 1.0;
}

/* slicing.py, mu(t) - mu_base: the motion's terms by axis, four in a texel, from texel `at` on */
vec3 moved(int o, int at, int mode, int groups, int first, int used, float delta) {
  vec3 sum = vec3(0.0);
  if (mode == BASIS_WEIGHTS) {
    for (int j = 0; j < used; j++) {
      vec4 w = instance_texel(o, INSTANCE_TEXELS + j);
      int k = at + first + j;
      sum += vec3(dot(w, geometry_texel(k)), dot(w, geometry_texel(k + groups)), dot(w, geometry_texel(k + 2 * groups)));
    }
  }
  if (mode == BASIS_POWERS) {
    float power = 1.0;
    for (int j = 0; j < groups; j++) {
      vec4 w = vec4(delta, delta * delta, delta * delta * delta, delta * delta * delta * delta) * power;
      power *= delta * delta * delta * delta;
      int k = at + j;
      sum += vec3(dot(w, geometry_texel(k)), dot(w, geometry_texel(k + groups)), dot(w, geometry_texel(k + 2 * groups)));
    }
  }
  return sum;
}

/* slicing.py, q(t) - c_0: the rotation's terms, one in a texel, from texel `at` on */
vec4 turned(int o, int at, int mode, int terms, int first, int used, int weights, float delta) {
  vec4 sum = vec4(0.0);
  if (mode == BASIS_WEIGHTS) {
    for (int j = 0; j < used; j++) {
      sum += instance_texel(o, weights + j).x * geometry_texel(at + first + j);
    }
  }
  if (mode == BASIS_POWERS) {
    float power = delta;
    for (int j = 0; j < terms; j++) {
      sum += power * geometry_texel(at + j);
      power *= delta;
    }
  }
  return sum;
}
"""

HARMONICS = """
/* appearance.sh_basis: the term Y_b of the unit direction d */
float harmonic(int b, vec3 d) {
  float x = d.x, y = d.y, z = d.z;
  float xx = x * x, yy = y * y, zz = z * z;
  if (b == 0) { return SH_C0; }
  if (b == 1) { return -SH_C1 * y; }
  if (b == 2) { return SH_C1 * z; }
  if (b == 3) { return -SH_C1 * x; }
  if (b == 4) { return SH_C2_0 * x * y; }
  if (b == 5) { return SH_C2_1 * y * z; }
  if (b == 6) { return SH_C2_2 * (2.0 * zz - xx - yy); }
  if (b == 7) { return SH_C2_3 * x * z; }
  if (b == 8) { return SH_C2_4 * (xx - yy); }
  if (b == 9) { return SH_C3_0 * y * (3.0 * xx - yy); }
  if (b == 10) { return SH_C3_1 * x * y * z; }
  if (b == 11) { return SH_C3_2 * y * (4.0 * zz - xx - yy); }
  if (b == 12) { return SH_C3_3 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy); }
  if (b == 13) { return SH_C3_4 * x * (4.0 * zz - xx - yy); }
  if (b == 14) { return SH_C3_5 * z * (xx - yy); }
  if (b == 15) { return SH_C3_6 * x * (xx - 3.0 * yy); }
  if (b == 16) { return SH_C4_0 * x * y * (xx - yy); }
  if (b == 17) { return SH_C4_1 * y * z * (3.0 * xx - yy); }
  if (b == 18) { return SH_C4_2 * x * y * (7.0 * zz - 1.0); }
  if (b == 19) { return SH_C4_3 * y * z * (7.0 * zz - 3.0); }
  if (b == 20) { return SH_C4_4 * (zz * (35.0 * zz - 30.0) + 3.0); }
  if (b == 21) { return SH_C4_5 * x * z * (7.0 * zz - 3.0); }
  if (b == 22) { return SH_C4_6 * (xx - yy) * (7.0 * zz - 1.0); }
  if (b == 23) { return SH_C4_7 * x * z * (xx - 3.0 * yy); }
  if (b == 24) { return SH_C4_8 * (xx * (xx - 3.0 * yy) - yy * (3.0 * xx - yy)); }
  return 0.0;
}

/* oracle.colours: sum_b Y_b c_b with the coefficients from texel `at` on, three texels for four of them */
vec3 harmonics(int at, int degree, vec3 d) {
  vec3 sum = vec3(0.0);
  int count = (degree + 1) * (degree + 1);
  for (int b = 0; b < count; b += 4) {
    vec4 p = colour_texel(at), q = colour_texel(at + 1), r = colour_texel(at + 2);
    sum += harmonic(b, d) * p.xyz + harmonic(b + 1, d) * vec3(p.w, q.xy);
    if (b + 2 < count) { sum += harmonic(b + 2, d) * vec3(q.zw, r.x) + harmonic(b + 3, d) * r.yzw; }
    at += 3;
  }
  return sum;
}

/* a constant colour, or one of the terms by which it changes */
vec3 plain_colour(int at, bool harmonic_colours, int degree, vec3 d) {
  return harmonic_colours ? harmonics(at, degree, d) : colour_texel(at).xyz;
}

/* appearance.features_at, then oracle.colours: f_0 + sum_k w_k(t) f_k, of which harmonics are a linear function */
vec3 colour_now(int o, int at, int texels, int degree, bool harmonic_colours, vec3 d, int weights, float delta) {
  vec4 changes = instance_texel(o, INSTANCE_CHANGES);
  int mode = whole(changes.x), terms = whole(changes.y), first = whole(changes.z), used = whole(changes.w);
  int step = texels / (1 + terms);
  vec3 sum = plain_colour(at, harmonic_colours, degree, d);
  if (mode == BASIS_WEIGHTS) {
    for (int j = 0; j < used; j++) {
      sum += instance_texel(o, weights + j).x * plain_colour(at + (1 + first + j) * step, harmonic_colours, degree, d);
    }
  }
  if (mode == BASIS_POWERS) {
    float power = delta;
    for (int j = 0; j < terms; j++) {
      sum += power * plain_colour(at + (1 + j) * step, harmonic_colours, degree, d);
      power *= delta;
    }
  }
  return harmonic_colours ? max(sum + vec3(0.5), vec3(0.0)) : sum;
}
"""

SAMPLED = """
/* distance.Sampling.blurs(): the blur, and the one whose share of opacity is kept; size: of a pixel; cameras: their first texel */
vec2 blurs(int o, float blur, float size, bool fades, vec3 p, float largest, int cameras) {
  vec4 ball = instance_texel(o, INSTANCE_BEYOND), sampling = instance_texel(o, INSTANCE_SAMPLING);
  float found = max(sampling.y, sampling.x * (length(p - ball.xyz) + ball.w));
  if (size > MARGIN * found) {
    float k = MARGIN * found / size;
    return vec2(blur, fades ? blur * k * k : blur);
  }
  for (int i = 0; i < whole(sampling.w) && found > MARGIN * size; i++) {
    vec4 place = instance_texel(o, cameras + 2 * i), axis = instance_texel(o, cameras + 2 * i + 1);
    vec3 away = p - place.xyz;
    float along = dot(away, axis.xyz);
    float close = abs(along) * place.w;
    if (close < found) {
      float r = sqrt(max(dot(away, away) - along * along, 0.0));
      found = min(found, close + STEEP * max((r - sampling.z * largest) * axis.w - along, 0.0) * place.w);
    }
  }
  float finer = max(max(found, sampling.y) / (MARGIN * size), 1.0);
  return vec2(blur * finer * finer);
}
"""

NEARNESS = """
/* oracle.nearness of a Gaussian beside the picture: along is the clamped tangent, f0 to f2 the columns of its factor in the camera */
float nearness(vec3 p, vec2 along, vec3 f0, vec3 f1, vec3 f2) {
  float deep = length(vec3(f0.z, f1.z, f2.z));
  if (!(p.z < REACH * deep)) { return 1.0 / p.z; }
  float share = min(REACH - p.z / deep, 1.0);
  f0 /= deep; /* so that products of small sizes stay numbers */
  f1 /= deep;
  f2 /= deep;
  vec3 s0 = cross(f1, f2), s1 = cross(f2, f0), s2 = cross(f0, f1), ray = vec3(along, 1.0);
  vec3 across = vec3(dot(s0, ray), dot(s1, ray), dot(s2, ray));
  float square = dot(across, across), densest = p.z;
  if (square > 0.0) { densest = max(dot(across, vec3(dot(s0, p), dot(s1, p), dot(s2, p))) / square, 0.5 * p.z); }
  return (1.0 - share) / p.z + share / densest;
}
"""

VERTEX = constants.VIEW + constants.INSTANCES + constants.HARMONICS + grade.GRADE + FETCH + SLICE + HARMONICS + SAMPLED + NEARNESS + """
void main()
{
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0); /* not drawn */
  v_uv = vec2(0.0);
  v_alpha = vec4(0.0);
  v_first = vec3(0.0);
#ifdef FEATURES
  v_second = vec3(0.0);
  v_third = vec3(0.0);
#endif
  v_own = vec2(0.0);

  vec4 size = view_texel(VIEW_SIZE), centre = view_texel(VIEW_CENTRE), limits = view_texel(VIEW_LIMITS);
  vec4 depths = view_texel(VIEW_DEPTHS), counts = view_texel(VIEW_COUNTS);
  bool orthographic = centre.z > 0.5;
  int drawn = whole(counts.x) * WIDTH + whole(counts.y);
  int k = drawn - 1 - gl_InstanceID; /* the list is front to back */
  vec4 listed = texelFetch(t_order, ivec2(k % ORDER_WIDTH, k / ORDER_WIDTH), 0); /* which, and what crops take of its opacity */
  int g = whole(listed.x);
  int o = instance_of(g, whole(centre.w));
  int i = g - first_of(o);

  vec4 row0 = instance_texel(o, INSTANCE_TO_CAMERA), row1 = instance_texel(o, INSTANCE_TO_CAMERA + 1);
  vec4 row2 = instance_texel(o, INSTANCE_TO_CAMERA + 2), eye = instance_texel(o, INSTANCE_EYE);
  vec4 where_geometry = instance_texel(o, INSTANCE_GEOMETRY), where_colour = instance_texel(o, INSTANCE_COLOUR);
  vec4 time = instance_texel(o, INSTANCE_TIME), bases = instance_texel(o, INSTANCE_BASES), group = instance_texel(o, INSTANCE_GROUP);
  vec4 raster = instance_texel(o, INSTANCE_RASTER);

  /* slicing.py: opacity, rotation and position at the time */

  int at = whole(where_geometry.x) * WIDTH + whole(where_geometry.y) + i * whole(where_geometry.z);
  vec4 fixed_part = geometry_texel(at);
  vec4 q = geometry_texel(at + 1);
  vec4 scale_time = geometry_texel(at + 2);
  float delta = time.x - scale_time.w;
  at += 3;
  vec4 temporal = vec4(0.0);
  int kind = whole(time.y);
  if (kind > 0) {
    temporal = geometry_texel(at);
    at += 1;
  }
  vec4 look = instance_texel(o, INSTANCE_LOOK), grading = instance_texel(o, INSTANCE_LOOK + 1); /* looks.py */
  float faintness = 1.0 + exp(-fixed_part.w);
  if (faintness > look.y) { return; }
  float sigma = temporal_factor(kind, time.x, scale_time.w, temporal) / faintness * look.x * (1.0 - listed.y);
  if (!(sigma >= raster.z)) { return; }
  int turns = whole(bases.w);
  int used = whole(bases.y);
  q += turned(o, at, whole(bases.z), turns, whole(group.x), whole(group.y), INSTANCE_TEXELS + used, delta);
  at += turns;
  vec3 p = fixed_part.xyz + moved(o, at, whole(time.z), whole(time.w), whole(bases.x), used, delta);

  /* oracle.project from here on */
  vec4 p1 = vec4(p, 1.0);
  float x = dot(row0, p1), y = dot(row1, p1), z = dot(row2, p1);
  vec4 first = instance_texel(o, INSTANCE_FIRST);
  if (!(z > raster.x && z <= first.y)) { return; }
  float norm = length(q);
  q = norm > 1e-12 ? q / norm : vec4(1.0, 0.0, 0.0, 0.0);

  float fx = size.z, fy = size.w;
  vec3 sd = exp(scale_time.xyz);
  float largest = max(sd.x, max(sd.y, sd.z));
  if (grading.y > 0.5 && largest > 0.0) { sd *= clamp(largest * look.z, look.w, grading.x) / largest; }
  float w2 = q.x, qx = q.y, qy = q.z, qz = q.w;
  vec3 axis0 = sd.x * vec3(1.0 - 2.0 * (qy * qy + qz * qz), 2.0 * (qx * qy + w2 * qz), 2.0 * (qx * qz - w2 * qy));
  vec3 axis1 = sd.y * vec3(2.0 * (qx * qy - w2 * qz), 1.0 - 2.0 * (qx * qx + qz * qz), 2.0 * (qy * qz + w2 * qx));
  vec3 axis2 = sd.z * vec3(2.0 * (qx * qz + w2 * qy), 2.0 * (qy * qz - w2 * qx), 1.0 - 2.0 * (qx * qx + qy * qy));

  /* the projection's Jacobian, clamped beside the picture, and the depth at which it is taken */
  float per_depth = 1.0, shear_x = 0.0, shear_y = 0.0;
  vec2 mean = vec2(x, y);
  if (!orthographic) {
    per_depth = 1.0 / z;
    mean *= per_depth;
    vec2 along = clamp(mean, limits.xz, limits.yw);
    shear_x = -along.x;
    shear_y = -along.y;
    if (any(notEqual(along, mean))) {
      float near_by = nearness(vec3(x, y, z), along, vec3(dot(row0.xyz, axis0), dot(row1.xyz, axis0), dot(row2.xyz, axis0)),
                               vec3(dot(row0.xyz, axis1), dot(row1.xyz, axis1), dot(row2.xyz, axis1)),
                               vec3(dot(row0.xyz, axis2), dot(row1.xyz, axis2), dot(row2.xyz, axis2)));
      if (near_by != per_depth) {
        per_depth = near_by;
        mean = along + (vec2(x, y) - along * z) * per_depth;
      }
    }
  }
  mean = vec2(fx, fy) * mean + centre.xy;

  /* the two rows u and v of J W, then of the 2 x 3 factor J W R S; Sigma_2D = (J W R S)(J W R S)^T = [[a, b], [b, c]] */
  vec3 u_row = fx * per_depth * (row0.xyz + shear_x * row2.xyz);
  vec3 v_row = fy * per_depth * (row1.xyz + shear_y * row2.xyz);
  vec3 u = vec3(dot(u_row, axis0), dot(u_row, axis1), dot(u_row, axis2));
  vec3 v = vec3(dot(v_row, axis0), dot(v_row, axis1), dot(v_row, axis2));
  float a = dot(u, u), b = dot(u, v), c = dot(v, v);
  vec3 area = cross(u, v); /* det Sigma_2D as a sum of squares (Cauchy-Binet) */
  float sharp = dot(area, area);
  vec2 both = raster.ww;
  if (first.z > 0.0) {
    int cameras = INSTANCE_TEXELS + used + whole(group.y) + whole(instance_texel(o, INSTANCE_CHANGES).w);
    both = blurs(o, raster.w, first.z * (orthographic ? 1.0 : z), first.w > 0.5, p, max(sd.x, max(sd.y, sd.z)), cameras);
  }
  float blur = both.x;
  float det = sharp + blur * (a + c) + blur * blur;
  float trace = a + c;
  a += blur;
  c += blur;
  if (!(det > 0.0) || !(a + c < 1e30)) { return; }
  if (eye.w > 0.5) {
    sigma *= sqrt(sharp / det);
    if (!(sigma >= raster.z)) { return; }
  }

  /* the ellipse's axes; its smaller eigenvalue from the determinant, which needles do not cancel */
  float half_difference = 0.5 * (a - c);
  float radius = sqrt(half_difference * half_difference + b * b);
  float large = 0.5 * (a + c) + radius;
  float small = det / large;
  vec2 axis = half_difference >= 0.0 ? vec2(half_difference + radius, b) : vec2(b, radius - half_difference);
  float axis_length = length(axis);
  axis = axis_length > 1e-20 ? axis / axis_length : vec2(1.0, 0.0);
  v_uv = corner * (sqrt(2.0 * log(sigma / raster.z)) * 1.0005 + 1e-4);
  mean += v_uv.x * sqrt(large) * axis + v_uv.y * sqrt(small) * vec2(-axis.y, axis.x);
  float depth = depths.x + (orthographic ? depths.y * z : depths.y / z);
  float faint = 1.0;
  if (both.y < blur) {
    faint = sqrt((sharp + both.y * trace + both.y * both.y) / det);
    if (!(faint > 0.0)) { return; }
  }
  v_alpha = vec4(sigma * faint, raster.y, raster.z * faint, depth);
  v_own.y = min(z, FARTHEST);
  gl_Position = vec4(2.0 * mean.x / size.x - 1.0, 1.0 - 2.0 * mean.y / size.y, 0.0, 1.0);

  if (whole(group.z) != whole(depths.w)) { return; } /* of another group: black */
  v_own.x = 1.0;
  at = whole(where_colour.x) * WIDTH + whole(where_colour.y) + i * whole(where_colour.z);
#ifdef FEATURES
  v_first = colour_texel(at).xyz;
  v_second = colour_texel(at + 1).xyz;
  v_third = colour_texel(at + 2).xyz * delta;
#else
  vec3 d = orthographic ? eye.xyz : p - eye.xyz;
  v_first = colour_now(o, at, whole(where_colour.z), whole(where_colour.w), whole(where_geometry.w) == COLOURS_HARMONICS,
                       d / max(length(d), 1e-30), INSTANCE_TEXELS + used + whole(group.y), delta);
  v_first = graded(v_first, grading, instance_texel(o, INSTANCE_LOOK + 2), instance_texel(o, INSTANCE_LOOK + 3),
                   instance_texel(o, INSTANCE_LOOK + 4));
#endif
}
"""

FRAGMENT = constants.VIEW + """
void main()
{
  /* oracle.rasterise: alpha of the splat at this pixel; v_uv is in standard deviations */
  float alpha = min(v_alpha.y, v_alpha.x * exp(-0.5 * dot(v_uv, v_uv)));
  if (alpha < v_alpha.z) { discard; }
  vec4 depths = texelFetch(t_table, ivec2(VIEW_DEPTHS, 0), 0);
  if (depths.z > 0.5) {
    vec4 size = texelFetch(t_table, ivec2(VIEW_SIZE, 0), 0), counts = texelFetch(t_table, ivec2(VIEW_COUNTS, 0), 0);
    ivec2 pixel = ivec2(gl_FragCoord.xy * counts.zw / size.xy);
    if (v_alpha.w > texelFetch(t_depth, pixel, 0).x) { discard; }
  }
  out_first = vec4(v_first * alpha, alpha);
#ifdef FEATURES
  out_second = vec4(v_second * alpha, alpha);
  out_third = vec4(v_third * alpha, alpha);
#endif
#ifdef OWN
  out_own = vec4(v_own * alpha, 0.0, alpha);
#endif
}
"""
