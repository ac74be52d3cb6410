# SPDX-License-Identifier: GPL-3.0-or-later
"""Colour curves and looks of colours, for the shaders of splats and of pictures; rendering/looks.py and colour.py state them."""
from __future__ import annotations

from . import constants

GRADE = constants.GRADE + """
/* colour.srgb_to_linear and back */
float to_linear(float x)
{
  float a = abs(x);
  float y = a <= SRGB_CUT ? a / SRGB_SLOPE : pow((a + SRGB_OFFSET) / (1.0 + SRGB_OFFSET), SRGB_GAMMA);
  return x < 0.0 ? -y : y;
}
float to_srgb(float x)
{
  return x <= SRGB_LINEAR_CUT ? x * SRGB_SLOPE : (1.0 + SRGB_OFFSET) * pow(x, 1.0 / SRGB_GAMMA) - SRGB_OFFSET;
}

/* looks.graded; b to e are the last four of the five texels of a look */
vec3 graded(vec3 colour, vec4 b, vec4 c, vec4 d, vec4 e)
{
  if (b.z < 0.5) { return colour; }
  bool linear = b.w > 0.5;
  vec3 x = linear ? colour : vec3(to_linear(colour.x), to_linear(colour.y), to_linear(colour.z));
  x = max(vec3(dot(vec3(c.zw, d.x), x), dot(d.yzw, x), dot(e.xyz, x)), vec3(0.0));
  for (int k = 0; k < 3; k++) {
    x[k] = x[k] > 0.0 ? c.x * pow(x[k], c.y) : (c.y > 0.0 ? 0.0 : c.x);
    if (!linear) { x[k] = to_srgb(x[k]); }
  }
  return x;
}
"""
