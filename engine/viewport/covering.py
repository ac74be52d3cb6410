# SPDX-License-Identifier: GPL-3.0-or-later
"""The shader that removes overlays where splats lie in front of them: Blender draws overlays over the picture without regard to its depth.

It multiplies the overlays' colours by the transmittance of the splats.  The depth test, against the depth that overlays have written, keeps
the overlays in front of the splats; the floor's grid writes no depth, so its depth is computed here.
"""
from enum import IntEnum

import numpy as np

from ...fastgs_blender.cameras.camera import Camera
from ...fastgs_blender.kernels.gl.constants import defines, texels
from ...fastgs_blender.kernels.gl.frame_table import Depths

MARKS = 2
"""Places in the window that stay as they are: the 3D cursor and the active object's origin, which Blender draws over everything."""


class CoveringTexel(IntEnum):
    """Places in the row of the texture that holds the shader's parameters.

    SIZE        width and height of the picture, orthographic
    WINDOW      width and height of the window
    LENS        fx, fy, cx, cy
    HEIGHT      row of the matrix from the camera's space to the world that gives the height over the floor
    DEPTHS      see Depths; whether the floor's grid is drawn
    FIRST_MARK  x, y from the lower left corner, radius, in the window's pixels; MARKS of them
    """

    SIZE = 0
    WINDOW = 1
    LENS = 2
    HEIGHT = 3
    DEPTHS = 4
    FIRST_MARK = 5


def covering_table(camera: Camera, depths: Depths, window: tuple[int, int], floor: bool, marks) -> np.ndarray:
    """float32 [1, texels, 4]; marks is a list of (x, y, radius)."""
    at = CoveringTexel
    values = np.zeros((1, at.FIRST_MARK + MARKS, 4), np.float32)
    row = values[0]
    row[at.SIZE, :3] = camera.width, camera.height, camera.orthographic
    row[at.WINDOW, :2] = window
    row[at.LENS] = camera.fx, camera.fy, camera.cx, camera.cy
    row[at.HEIGHT] = np.linalg.inv(camera.world_to_camera)[2]
    row[at.DEPTHS, :3] = depths.a, depths.b, floor
    for number, mark in enumerate(marks[:MARKS]):
        row[at.FIRST_MARK + number, :3] = mark
    return values


FRAGMENT = defines(**texels("COVERING", CoveringTexel), COVERING_MARKS=MARKS) + """
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
