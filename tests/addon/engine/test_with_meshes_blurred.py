# SPDX-License-Identifier: GPL-3.0-or-later
"""*Render With Meshes*: meshes that move."""
import numpy as np
from joined import column


def test_what_moves_before_a_holdout_is_blurred(scene, screen, wall, add_camera, choose, render):
    """The part of a pixel that a mesh's blur leaves is the holdout's hole, as in Cycles' picture of the meshes alone."""
    add_camera(lens=30.0)
    scene.render.film_transparent = scene.render.use_motion_blur = True
    scene.render.motion_blur_shutter = 1.0
    wall(0.5, -0.5, (1, 0, 1), size=5.0).is_holdout = True
    moves = wall(0, -1.0, (0, 1, 0), size=1.6)
    for frame, x in ((0, 0.0), (2, 1.0)):
        moves.location.x = x
        moves.keyframe_insert("location", index=0, frame=frame)
    choose().cycles.samples = 128
    alpha = render("PNG16")[24, :, 3]
    assert alpha[column(0.6, -1)] > 0.98 and alpha[column(1.8, -1)] < 0.02 and (np.diff(alpha[column(0.6, -1):]) < 0.03).all()
    assert 0.3 < alpha[column(1.3, -1)] < 0.7
