# SPDX-License-Identifier: GPL-3.0-or-later
"""The shaders that turn blended splats into scene-linear colour."""
from ..equations.text import glsl
from . import constants

VERTEX = """
void main()
{
  v_uv = 0.5 * corner + 0.5;
  gl_Position = vec4(corner, 0.0, 1.0);
}
"""

FRAGMENT = constants.RESOLVE + """
vec4 row(int j) { return texelFetch(t_resolve, ivec2(j, 0), 0); }
vec4 w1(int h, int k) { return row(RESOLVE_W1 + 3 * h + k); }
vec3 w2(int h) { return row(RESOLVE_W2 + h).xyz; }
""" + glsl("srgb", "looks", "decode") + """
#ifdef FEATURES
/* appearance.decode, for the ray through a pixel */
vec3 decoded(vec3 base, vec3 direction, vec3 time, vec2 pixel, int activation)
{
  vec4 size = row(RESOLVE_SIZE), lens = row(RESOLVE_LENS);
  vec4 x_row = row(RESOLVE_TO_MODEL), y_row = row(RESOLVE_TO_MODEL + 1), z_row = row(RESOLVE_TO_MODEL + 2);
  vec3 ray = ray_of(vec2(pixel.x, size.y - pixel.y), lens, size.z > 0.5, x_row.xyz, y_row.xyz, z_row.xyz);
  vec3 eye = vec3(x_row.w, y_row.w, z_row.w);
  vec4 in0 = vec4(direction, time.x), in1 = vec4(time.yz, eye.xy), in2 = vec4(eye.z, ray);
  vec3 rgb = base;
  for (int h = 0; h < DECODER_HIDDEN; h++) { rgb += w2(h) * hidden_unit(h, in0, in1, in2); }
  return activated(rgb, activation);
}
#endif

#ifdef SKY
/* sky.Panorama.towards, for the ray through a place in the window */
vec3 sky_texel(int x, int y, ivec2 size) { return texelFetch(t_sky, ivec2(x < 0 ? x + size.x : (x < size.x ? x : x - size.x), y), 0).rgb; }

vec3 behind(vec2 place)
{
  vec4 sizes = row(RESOLVE_SKY), lens = row(RESOLVE_LENS);
  vec3 ray = ray_of(vec2(place.x, 1.0 - place.y) * sizes.zw, lens, row(RESOLVE_SIZE).z > 0.5, row(RESOLVE_TO_WORLD).xyz,
                    row(RESOLVE_TO_WORLD + 1).xyz, row(RESOLVE_TO_WORLD + 2).xyz);
  float u = (atan(ray.x, ray.y) / 6.283185307179586 + 0.5) * sizes.x - 0.5;
  float v = clamp((asin(clamp(ray.z, -1.0, 1.0)) / 3.141592653589793 + 0.5) * sizes.y - 0.5, 0.0, sizes.y - 1.0);
  ivec2 size = ivec2(sizes.xy);
  int left = int(floor(u)), low = min(int(floor(v)), size.y - 2);
  float across = u - floor(u), up = v - float(low);
  vec3 below = mix(sky_texel(left, low, size), sky_texel(left + 1, low, size), across);
  vec3 above = mix(sky_texel(left, low + 1, size), sky_texel(left + 1, low + 1, size), across);
  return mix(below, above, up);
}
#endif

void main()
{
  vec4 kind = row(RESOLVE_KIND), under = row(RESOLVE_BACKGROUND), border = row(RESOLVE_BORDER);
  vec4 whole_picture = row(RESOLVE_WHOLE), size = row(RESOLVE_SIZE);
  if (v_uv.x < border.x || v_uv.y < border.y || v_uv.x >= border.z || v_uv.y >= border.w) { discard; }
  ivec2 pixel = min(ivec2(v_uv * size.xy), ivec2(size.xy) - ivec2(1));
  vec4 first = texelFetch(t_first, pixel, 0);
  float alpha = first.a;
  float weight = alpha;
  float mark = 0.0;
#ifdef OWN
  vec4 own = texelFetch(t_own, pixel, 0);
  alpha = own.a;
  mark = own.z;
  if (kind.z < 0.5) { weight = own.x; } /* else a sum of groups, which brings its weight along */
#endif
  vec3 rgb = vec3(0.0);
  if (weight > 0.0) {
    rgb = first.rgb / weight;
#ifdef FEATURES
    vec2 place = vec2(pixel) + vec2(0.5);
    vec3 second = texelFetch(t_second, pixel, 0).rgb, third = texelFetch(t_third, pixel, 0).rgb;
    int activation = int(kind.y + 0.5);
    if (int(whole_picture.z + 0.5) == DECODE_PREMULTIPLIED) {
      vec3 whole = decoded(first.rgb, second, third, place, activation);
      rgb = lifted(whole, decoded(vec3(0.0), vec3(0.0), vec3(0.0), place, activation), weight, activation);
    }
    else {
      rgb = decoded(rgb, second / weight, third / weight, place, activation);
    }
    int look = mark > 0.0 ? RESOLVE_SELECTED : RESOLVE_REFUSED;
    vec3 marked = mark == 0.0 ? rgb : graded(rgb, row(look + 1), row(look + 2), row(look + 3), row(look + 4));
    rgb = graded(rgb, row(RESOLVE_LOOK + 1), row(RESOLVE_LOOK + 2), row(RESOLVE_LOOK + 3), row(RESOLVE_LOOK + 4));
    rgb = mix(rgb, marked, min(abs(mark) / weight, 1.0));
#endif
    vec4 frame = row(RESOLVE_FRAME);
    if (v_uv.x < frame.x || v_uv.y < frame.y || v_uv.x >= frame.z || v_uv.y >= frame.w) { rgb *= size.w; }
    if (kind.x > 0.5) { rgb = vec3(to_linear(rgb.x), to_linear(rgb.y), to_linear(rgb.z)); }
    rgb = vec3(dot(row(RESOLVE_WORKING).xyz, rgb), dot(row(RESOLVE_WORKING + 1).xyz, rgb), dot(row(RESOLVE_WORKING + 2).xyz, rgb)) * weight;
  }
  if (kind.w > 0.5) { /* to be summed */
    out_colour = vec4(rgb, weight);
    return;
  }
  /* the first one also brings the background and the coverage; the others only add their light */
  if (whole_picture.x > 0.5) {
#ifdef SKY
    under.rgb = behind(v_uv);
#endif
    rgb += (1.0 - alpha) * under.rgb * under.a;
    out_colour = vec4(rgb, under.a > 0.5 ? 1.0 : alpha) * whole_picture.y;
  }
  else {
    out_colour = vec4(rgb * whole_picture.y, 0.0);
  }
}
"""

SHOW = constants.RESOLVE + """
/* puts a finished picture into the window; the depth test hides what lies behind that of the window */
void main()
{
  vec4 shown = texelFetch(t_shown, ivec2(v_uv * vec2(textureSize(t_shown, 0))), 0);
#ifdef FADING
  /* one picture over another, of which a share is drawn afterwards: together they are the mean of both by their shares */
  shown *= share / max(1.0 - rest * texelFetch(t_over, ivec2(v_uv * vec2(textureSize(t_over, 0))), 0).a, 1e-6);
#endif
#ifdef DEEP
  vec4 size = texelFetch(t_resolve, ivec2(RESOLVE_SIZE, 0), 0), depths = texelFetch(t_resolve, ivec2(RESOLVE_DEPTHS, 0), 0);
  vec4 own = texelFetch(t_own, min(ivec2(v_uv * size.xy), ivec2(size.xy) - ivec2(1)), 0);
  if (own.a <= 0.0) { discard; }
  float z = own.y / own.a;
  gl_FragDepth = clamp(depths.x + (size.z > 0.5 ? depths.y * z : depths.y / z), 0.0, 1.0);
#ifdef ORDERED
  /* of two pictures the farther one comes first, pixel by pixel: where it is not hidden, the nearer one is not either */
  vec4 other = texelFetch(t_other, ivec2(v_uv * vec2(textureSize(t_other, 0))), 0);
  bool farther = other.a > 0.0 && (newer > 0.5 ? z * other.a > other.y : z * other.a >= other.y);
  if (farther != rest > 0.0) { discard; }
#endif
#endif
  out_colour = shown;
}
"""
