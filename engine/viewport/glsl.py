# SPDX-License-Identifier: GPL-3.0-or-later
"""The shaders' text.  The maths is fastgs_blender/rendering/oracle.py's; the layout of the textures is records.py's and parameters.py's.

Written to be translated to Vulkan and Metal too: no integer textures, no arrays of samplers, no mixing of int and float.
"""

COMMON = """
#define WIDTH 8192
#define ORDER_WIDTH 4096
#define HEAD 11

int whole(float x) { return int(floor(x + 0.5)); }
vec4 view_row(int j) { return texelFetch(t_table, ivec2(j, 0), 0); }
vec4 object_row(int o, int j) { return texelFetch(t_table, ivec2(j, o + 1), 0); }
vec4 geometry_texel(int i) { return texelFetch(t_geometry, ivec2(i % WIDTH, i / WIDTH), 0); }
vec4 colour_texel(int i) { return texelFetch(t_colour, ivec2(i % WIDTH, i / WIDTH), 0); }
"""

SLICE = """
int first_of(int o) {
  return whole(object_row(o, 8).w) * WIDTH + whole(object_row(o, 10).x);
}

int object_of(int g, int objects) {
  int low = 0;
  int high = objects;
  while (high - low > 1) {
    int middle = (low + high) / 2;
    if (first_of(middle) <= g) { low = middle; } else { high = middle; }
  }
  return low;
}

float temporal_factor(int kind, float t, float mu_tau, vec4 p) {
  if (kind == 1) {
    float d = t - mu_tau;
    return exp(-exp(p.x) * d * d);
  }
  if (kind == 2) {
    float early = max(p.x - t, 0.0) / exp(p.z);
    float late = max(t - p.y, 0.0) / exp(p.w);
    return exp(-early * early - late * late);
  }
  if (kind == 3) {
    float d = t - mu_tau;
    float outside = max(max(p.y - t, t - p.z), 0.0) / exp(p.w);
    return exp(-exp(p.x) * d * d - outside * outside);
  }
  return 1.0;
}

/* the motion's offset: terms by axis, four in a texel, from texel `at` on */
vec3 moved(int o, int at, int mode, int groups, int first, int used, float delta) {
  vec3 sum = vec3(0.0);
  if (mode == 1) {
    for (int j = 0; j < used; j++) {
      vec4 w = object_row(o, HEAD + j);
      int k = at + first + j;
      sum += vec3(dot(w, geometry_texel(k)), dot(w, geometry_texel(k + groups)), dot(w, geometry_texel(k + 2 * groups)));
    }
  }
  if (mode == 2) {
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

vec4 turned(int o, int at, int mode, int terms, int first, int used, int weights, float delta) {
  vec4 sum = vec4(0.0);
  if (mode == 1) {
    for (int j = 0; j < used; j++) {
      sum += object_row(o, weights + j).x * geometry_texel(at + first + j);
    }
  }
  if (mode == 2) {
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
/* appearance.sh_basis, one coefficient at a time */
float harmonic(int b, vec3 d) {
  float x = d.x, y = d.y, z = d.z;
  float xx = x * x, yy = y * y, zz = z * z;
  if (b == 0) { return 0.28209479177387814; }
  if (b == 1) { return -0.4886025119029199 * y; }
  if (b == 2) { return 0.4886025119029199 * z; }
  if (b == 3) { return -0.4886025119029199 * x; }
  if (b == 4) { return 1.0925484305920792 * x * y; }
  if (b == 5) { return -1.0925484305920792 * y * z; }
  if (b == 6) { return 0.31539156525252005 * (2.0 * zz - xx - yy); }
  if (b == 7) { return -1.0925484305920792 * x * z; }
  if (b == 8) { return 0.5462742152960396 * (xx - yy); }
  if (b == 9) { return -0.5900435899266435 * y * (3.0 * xx - yy); }
  if (b == 10) { return 2.890611442640554 * x * y * z; }
  if (b == 11) { return -0.4570457994644658 * y * (4.0 * zz - xx - yy); }
  if (b == 12) { return 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy); }
  if (b == 13) { return -0.4570457994644658 * x * (4.0 * zz - xx - yy); }
  if (b == 14) { return 1.445305721320277 * z * (xx - yy); }
  if (b == 15) { return -0.5900435899266435 * x * (xx - 3.0 * yy); }
  if (b == 16) { return 2.5033429417967046 * x * y * (xx - yy); }
  if (b == 17) { return -1.7701307697799304 * y * z * (3.0 * xx - yy); }
  if (b == 18) { return 0.9461746957575601 * x * y * (7.0 * zz - 1.0); }
  if (b == 19) { return -0.6690465435572892 * y * z * (7.0 * zz - 3.0); }
  if (b == 20) { return 0.10578554691520431 * (zz * (35.0 * zz - 30.0) + 3.0); }
  if (b == 21) { return -0.6690465435572892 * x * z * (7.0 * zz - 3.0); }
  if (b == 22) { return 0.47308734787878004 * (xx - yy) * (7.0 * zz - 1.0); }
  if (b == 23) { return -1.7701307697799304 * x * z * (xx - 3.0 * yy); }
  if (b == 24) { return 0.6258357354491761 * (xx * (xx - 3.0 * yy) - yy * (3.0 * xx - yy)); }
  return 0.0;
}

vec3 harmonics(int at, int degree, vec3 d) {
  vec3 sum = vec3(0.5);
  int count = (degree + 1) * (degree + 1);
  for (int b = 0; b < count; b += 4) {
    vec4 p = colour_texel(at), q = colour_texel(at + 1), r = colour_texel(at + 2);
    sum += harmonic(b, d) * p.xyz + harmonic(b + 1, d) * vec3(p.w, q.xy);
    if (b + 2 < count) { sum += harmonic(b + 2, d) * vec3(q.zw, r.x) + harmonic(b + 3, d) * r.yzw; }
    at += 3;
  }
  return max(sum, vec3(0.0));
}
"""

SPLAT_VERTEX = COMMON + SLICE + HARMONICS + """
void main()
{
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0); /* not drawn */
  v_uv = vec2(0.0);
  v_look = vec4(0.0);
  v_first = vec3(0.0);
#ifdef FEATURES
  v_second = vec3(0.0);
  v_third = vec3(0.0);
#endif
  v_own = 0.0;

  vec4 size = view_row(0), centre = view_row(1), limits = view_row(2), depths = view_row(3), counts = view_row(4);
  bool orthographic = centre.z > 0.5;
  int drawn = whole(counts.x) * WIDTH + whole(counts.y);
  int k = drawn - 1 - gl_InstanceID; /* the list is front to back */
  int g = whole(texelFetch(t_order, ivec2(k % ORDER_WIDTH, k / ORDER_WIDTH), 0).x);
  int o = object_of(g, whole(centre.w));
  int i = g - first_of(o);

  vec4 row0 = object_row(o, 0), row1 = object_row(o, 1), row2 = object_row(o, 2), eye = object_row(o, 3);
  vec4 where_geometry = object_row(o, 4), where_colour = object_row(o, 5), time = object_row(o, 6);
  vec4 bases = object_row(o, 7), more = object_row(o, 8), raster = object_row(o, 9);

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
  float sigma = temporal_factor(kind, time.x, scale_time.w, temporal) / (1.0 + exp(-fixed_part.w));
  if (!(sigma >= raster.z)) { return; }
  int turns = whole(bases.w);
  int used = whole(bases.y);
  q += turned(o, at, whole(bases.z), turns, whole(more.x), whole(more.y), HEAD + used, delta);
  at += turns;
  vec3 p = fixed_part.xyz + moved(o, at, whole(time.z), whole(time.w), whole(bases.x), used, delta);

  vec4 p1 = vec4(p, 1.0);
  float x = dot(row0, p1), y = dot(row1, p1), z = dot(row2, p1);
  if (!(z > raster.x)) { return; }
  float norm = length(q);
  q = norm > 1e-12 ? q / norm : vec4(1.0, 0.0, 0.0, 0.0);

  float fx = size.z, fy = size.w;
  float per_depth = 1.0, shear_x = 0.0, shear_y = 0.0;
  if (!orthographic) {
    per_depth = 1.0 / z;
    shear_x = -clamp(x * per_depth, limits.x, limits.y);
    shear_y = -clamp(y * per_depth, limits.z, limits.w);
  }
  vec2 mean = vec2(fx * x * per_depth + centre.x, fy * y * per_depth + centre.y);

  /* the two rows of J W, then the 2 x 3 factor J W R S of the projected covariance */
  vec3 u_row = fx * per_depth * (row0.xyz + shear_x * row2.xyz);
  vec3 v_row = fy * per_depth * (row1.xyz + shear_y * row2.xyz);
  vec3 sd = exp(scale_time.xyz);
  float w2 = q.x, qx = q.y, qy = q.z, qz = q.w;
  vec3 axis0 = sd.x * vec3(1.0 - 2.0 * (qy * qy + qz * qz), 2.0 * (qx * qy + w2 * qz), 2.0 * (qx * qz - w2 * qy));
  vec3 axis1 = sd.y * vec3(2.0 * (qx * qy - w2 * qz), 1.0 - 2.0 * (qx * qx + qz * qz), 2.0 * (qy * qz + w2 * qx));
  vec3 axis2 = sd.z * vec3(2.0 * (qx * qz + w2 * qy), 2.0 * (qy * qz - w2 * qx), 1.0 - 2.0 * (qx * qx + qy * qy));
  vec3 u = vec3(dot(u_row, axis0), dot(u_row, axis1), dot(u_row, axis2));
  vec3 v = vec3(dot(v_row, axis0), dot(v_row, axis1), dot(v_row, axis2));
  float a = dot(u, u), b = dot(u, v), c = dot(v, v);
  vec3 area = cross(u, v);
  float sharp = dot(area, area);
  float blur = raster.w;
  float det = sharp + blur * (a + c) + blur * blur;
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
  v_look = vec4(sigma, raster.y, raster.z, depth);
  gl_Position = vec4(2.0 * mean.x / size.x - 1.0, 1.0 - 2.0 * mean.y / size.y, 0.0, 1.0);

  if (whole(more.z) != whole(depths.w)) { return; } /* of another group: black */
  v_own = 1.0;
  at = whole(where_colour.x) * WIDTH + whole(where_colour.y) + i * whole(where_colour.z);
#ifdef FEATURES
  v_first = colour_texel(at).xyz;
  v_second = colour_texel(at + 1).xyz;
  v_third = colour_texel(at + 2).xyz * delta;
#else
  if (whole(where_geometry.w) == 1) {
    vec3 d = orthographic ? eye.xyz : p - eye.xyz;
    v_first = harmonics(at, whole(where_colour.w), d / max(length(d), 1e-30));
  }
  else {
    v_first = colour_texel(at).xyz;
  }
#endif
}
"""

SPLAT_FRAGMENT = """
void main()
{
  float alpha = min(v_look.y, v_look.x * exp(-0.5 * dot(v_uv, v_uv)));
  if (alpha < v_look.z) { discard; }
  vec4 depths = texelFetch(t_table, ivec2(3, 0), 0);
  if (depths.z > 0.5) {
    vec4 size = texelFetch(t_table, ivec2(0, 0), 0), counts = texelFetch(t_table, ivec2(4, 0), 0);
    ivec2 pixel = ivec2(gl_FragCoord.xy * counts.zw / size.xy);
    if (v_look.w > texelFetch(t_depth, pixel, 0).x) { discard; }
  }
  out_first = vec4(v_first * alpha, alpha);
#ifdef FEATURES
  out_second = vec4(v_second * alpha, alpha);
  out_third = vec4(v_third * alpha, alpha);
#endif
#ifdef OWN
  out_own = vec4(v_own * alpha, 0.0, 0.0, alpha);
#endif
}
"""

RESOLVE_VERTEX = """
void main()
{
  v_uv = 0.5 * corner + 0.5;
  gl_Position = vec4(corner, 0.0, 1.0);
}
"""

RESOLVE_FRAGMENT = """
vec4 row(int j) { return texelFetch(t_resolve, ivec2(j, 0), 0); }

float to_linear(float x)
{
  float a = abs(x);
  float y = a <= 0.04045 ? a / 12.92 : pow((a + 0.055) / 1.055, 2.4);
  return x < 0.0 ? -y : y;
}

#ifdef FEATURES
vec3 decoded(vec3 base, vec3 direction, vec3 time, vec2 pixel, float activation)
{
  vec4 size = row(4), lens = row(5);
  vec3 ray = vec3(0.0, 0.0, 1.0);
  if (size.z < 0.5) { ray.xy = vec2((pixel.x - lens.z) / lens.x, (size.y - pixel.y - lens.w) / lens.y); }
  ray = vec3(dot(row(6).xyz, ray), dot(row(7).xyz, ray), dot(row(8).xyz, ray));
  ray /= max(length(ray), 1e-30);
  vec3 eye = vec3(row(6).w, row(7).w, row(8).w);
  vec4 in0 = vec4(direction, time.x), in1 = vec4(time.yz, eye.xy), in2 = vec4(eye.z, ray);
  vec3 rgb = base;
  for (int h = 0; h < 6; h++) {
    float hidden = max(dot(row(9 + 3 * h), in0) + dot(row(10 + 3 * h), in1) + dot(row(11 + 3 * h), in2), 0.0);
    rgb += hidden * row(27 + h).xyz;
  }
  if (activation < 0.5) { return 1.0 / (1.0 + exp(-rgb)); }
  if (activation < 1.5) { return clamp(rgb, 0.0, 1.0); }
  return rgb;
}
#endif

void main()
{
  vec4 kind = row(0), under = row(1), border = row(2), whole_picture = row(3), size = row(4);
  if (v_uv.x < border.x || v_uv.y < border.y || v_uv.x >= border.z || v_uv.y >= border.w) { discard; }
  ivec2 pixel = min(ivec2(v_uv * size.xy), ivec2(size.xy) - ivec2(1));
  vec4 first = texelFetch(t_first, pixel, 0);
  float alpha = first.a;
  float weight = alpha;
#ifdef OWN
  vec4 own = texelFetch(t_own, pixel, 0);
  alpha = own.a;
  if (kind.z < 0.5) { weight = own.x; } /* else a sum of groups, which brings its weight along */
#endif
  vec3 rgb = vec3(0.0);
  if (weight > 0.0) {
    rgb = first.rgb / weight;
#ifdef FEATURES
    rgb = decoded(rgb, texelFetch(t_second, pixel, 0).rgb / weight, texelFetch(t_third, pixel, 0).rgb / weight,
                  vec2(pixel) + vec2(0.5), kind.y);
#endif
    vec4 frame = row(36);
    if (v_uv.x < frame.x || v_uv.y < frame.y || v_uv.x >= frame.z || v_uv.y >= frame.w) { rgb *= size.w; }
    if (kind.x > 0.5) { rgb = vec3(to_linear(rgb.x), to_linear(rgb.y), to_linear(rgb.z)); }
    rgb = vec3(dot(row(33).xyz, rgb), dot(row(34).xyz, rgb), dot(row(35).xyz, rgb)) * weight;
  }
  if (kind.w > 0.5) { /* to be summed */
    out_colour = vec4(rgb, weight);
    return;
  }
  /* the first one also brings the background and the coverage; the others only add their light */
  if (whole_picture.x > 0.5) {
    rgb += (1.0 - alpha) * under.rgb * under.a;
    out_colour = vec4(rgb, under.a > 0.5 ? 1.0 : alpha) * whole_picture.y;
  }
  else {
    out_colour = vec4(rgb * whole_picture.y, 0.0);
  }
}
"""
