# SPDX-License-Identifier: GPL-3.0-or-later
"""The shaders that slice, project and blend splats: one instance of a rectangle for each Gaussian."""
from ..equations.text import glsl
from . import constants

FETCH = """
int whole(float x) { return int(floor(x + 0.5)); }
vec4 view_texel(int j) { return texelFetch(t_table, ivec2(j, 0), 0); }
vec4 instance_texel(int o, int j) { return texelFetch(t_table, ivec2(j, o + 1), 0); }
vec4 geometry_texel(int i) { return texelFetch(t_geometry, ivec2(i % WIDTH, i / WIDTH), 0); }
vec4 colour_texel(int i) { return texelFetch(t_colour, ivec2(i % WIDTH, i / WIDTH), 0); }
vec4 captured(ivec2 source, int k) { return instance_texel(source.x, source.y + k); }
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

COLOUR = """
/* oracle.colours: sum_b Y_b c_b with the coefficients from texel `at` on, three texels for four of them, and Y_b in `terms` */
vec3 harmonics(int at, int degree) {
  vec3 sum = vec3(0.0);
  int count = (degree + 1) * (degree + 1);
  for (int b = 0; b < count; b += 4) {
    vec4 p = colour_texel(at), q = colour_texel(at + 1), r = colour_texel(at + 2);
    sum += terms[b] * p.xyz;
    if (b + 1 < count) { sum += terms[b + 1] * vec3(p.w, q.xy) + terms[b + 2] * vec3(q.zw, r.x) + terms[b + 3] * r.yzw; }
    at += 3;
  }
  return sum;
}

/* a constant colour, or one of the terms by which it changes */
vec3 plain_colour(int at, bool harmonic_colours, int degree) {
  return harmonic_colours ? harmonics(at, degree) : colour_texel(at).xyz;
}

/* appearance.features_at, then oracle.colours: f_0 + sum_k w_k(t) f_k, of which harmonics are a linear function */
vec3 colour_now(int o, int at, int texels, int degree, bool harmonic_colours, vec3 d, int weights, float delta) {
  vec4 changes = instance_texel(o, INSTANCE_CHANGES);
  int mode = whole(changes.x), count = whole(changes.y), first = whole(changes.z), used = whole(changes.w);
  int step = texels / (1 + count);
  if (harmonic_colours) { sh_terms(degree, d); }
  vec3 sum = plain_colour(at, harmonic_colours, degree);
  if (mode == BASIS_WEIGHTS) {
    for (int j = 0; j < used; j++) {
      sum += instance_texel(o, weights + j).x * plain_colour(at + (1 + first + j) * step, harmonic_colours, degree);
    }
  }
  if (mode == BASIS_POWERS) {
    float power = delta;
    for (int j = 0; j < count; j++) {
      sum += power * plain_colour(at + (1 + j) * step, harmonic_colours, degree);
      power *= delta;
    }
  }
  return harmonic_colours ? max(sum + vec3(0.5), vec3(0.0)) : sum;
}
"""

EQUATIONS = glsl("temporal", "rotation", "projection", "sampling", "spherical", "srgb", "looks")

VERTEX = constants.VIEW + constants.INSTANCES + FETCH + EQUATIONS + SLICE + COLOUR + """
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
  v_own = vec3(0.0);

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

  mat3 axes = axes_of(unit_quaternion(q));
  vec3 sd = exp(scale_time.xyz);
  sd *= size_factor(max(sd.x, max(sd.y, sd.z)), look, grading);
  vec4 lens = vec4(size.zw, centre.xy);
  vec3 camera = vec3(x, y, z);
  vec3 bent = shear(camera, limits, orthographic);
  if (!orthographic) { bent = linearised(camera, bent, row0.xyz, row1.xyz, row2.xyz, axes, sd); }
  vec2 mean = centre_of(camera, bent, lens, orthographic);
  vec3 deep = row2.xyz * axes;
  vec3 u = factor_row(lens.x, row0.xyz, bent.x, deep, axes, sd * bent.z);
  vec3 v = factor_row(lens.y, row1.xyz, bent.y, deep, axes, sd * bent.z);
  vec2 both = raster.ww;
  if (first.z > 0.0) {
    vec4 sampling = instance_texel(o, INSTANCE_SAMPLING);
    ivec2 cameras = ivec2(o, INSTANCE_TEXELS + used + whole(group.y) + whole(instance_texel(o, INSTANCE_CHANGES).w));
    both = blurs(cameras, whole(sampling.w), raster.w, first.z * (orthographic ? 1.0 : z), sampling.x > 0.0 && eye.w < 0.5,
                 instance_texel(o, INSTANCE_BEYOND), vec4(sampling.xyz, first.w), p, max(sd.x, max(sd.y, sd.z)));
  }
  float blur = both.x;
  Footprint found = footprint(u, v, blur);
  if (!(found.det > 0.0) || !(found.s00 + found.s11 < 1e30)) { return; }
  if (eye.w > 0.5) {
    sigma *= sqrt(found.sharp / found.det);
    if (!(sigma >= raster.z)) { return; }
  }

  /* the ellipse's axes; its smaller eigenvalue from the determinant, which needles do not cancel */
  float half_difference = 0.5 * (found.s00 - found.s11);
  float radius = sqrt(half_difference * half_difference + found.s01 * found.s01);
  float large = 0.5 * (found.s00 + found.s11) + radius;
  float small = found.det / large;
  vec2 axis = half_difference >= 0.0 ? vec2(half_difference + radius, found.s01) : vec2(found.s01, radius - half_difference);
  float axis_length = length(axis);
  axis = axis_length > 1e-20 ? axis / axis_length : vec2(1.0, 0.0);
  v_uv = corner * (sqrt(2.0 * log(sigma / raster.z)) * 1.0005 + 1e-4);
  mean += v_uv.x * sqrt(large) * axis + v_uv.y * sqrt(small) * vec2(-axis.y, axis.x);
  float depth = depths.x + (orthographic ? depths.y * z : depths.y / z);
  float faint = 1.0;
  if (both.y < blur) {
    faint = sqrt(blurred(found.sharp, found.trace, both.y) / found.det);
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
  v_own.z = instance_texel(o, INSTANCE_LOOK + 4).w;
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
  out_own = vec4(v_own * alpha, alpha);
#endif
}
"""
