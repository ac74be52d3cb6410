# SPDX-License-Identifier: GPL-3.0-or-later
"""The shader that removes overlays where splats lie in front of them: Blender draws overlays over the picture without regard to its depth.

It multiplies the overlays' colours by the transmittance of the splats.  The depth test, against the depth that overlays have written, keeps
the overlays in front of the splats; the floor's grid writes no depth, so its depth is computed here.
"""
from __future__ import annotations

from . import constants

FRAGMENT = constants.COVERING + """
vec4 row(int j) { return texelFetch(t_covering, ivec2(j, 0), 0); }

void main()
{
  vec4 size = row(COVERING_SIZE), lens = row(COVERING_LENS), height = row(COVERING_HEIGHT), depths = row(COVERING_DEPTHS);
  ivec2 texel = min(ivec2(v_uv * size.xy), ivec2(size.xy) - ivec2(1));
  vec4 own = texelFetch(t_own, texel, 0);
  if (own.a <= 0.0) { discard; }
  float z = own.y / own.a;
  vec2 pixel = v_uv * size.xy;
  vec2 at = vec2((pixel.x - lens.z) / lens.x, (size.y - pixel.y - lens.w) / lens.y);
  bool orthographic = size.z > 0.5;
  /* the height over the floor along the ray is start + slope * z */
  float start = height.w + (orthographic ? dot(height.xy, at) : 0.0);
  float slope = height.z + (orthographic ? 0.0 : dot(height.xy, at));
  float floor_z = abs(slope) > 1e-12 ? -start / slope : -1.0;
  if (depths.z > 0.5 && floor_z > 0.0 && floor_z < z) { discard; } /* the floor lies before the splats */
  for (int j = 0; j < COVERING_MARKS; j++) {
    vec4 mark = row(COVERING_FIRST_MARK + j);
    if (distance(v_uv * row(COVERING_WINDOW).xy, mark.xy) < mark.z) { discard; }
  }
  gl_FragDepth = clamp(depths.x + (orthographic ? depths.y * z : depths.y / z), 0.0, 1.0);
  out_colour = vec4(1.0 - own.a);
}
"""
