# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws in a 3D view what the mouse draws: the trail of a brush, a box, a lasso, a ball."""
from itertools import pairwise
from math import cos, pi, sin

import gpu
from gpu_extras.batch import batch_for_shader
from mathutils import Vector

TAKES, LEAVES = (1.0, 0.6, 0.2, 0.35), (0.35, 0.65, 1.0, 0.35)
"""Of a selection."""
HIDES, SHOWS = (1.0, 0.45, 0.35, 0.35), (0.45, 0.8, 1.0, 0.35)
"""Of an eraser."""
LINE = 0.9
"""Opacity of lines."""


def draw(shape: str, points: list[Vector], radius: float, what: str, mode: str) -> None:
    """Draw a path of the mouse, in pixels of the region; shape, what and mode are those of the operator."""
    colour = {'ERASE': HIDES, 'RESTORE': SHOWS}.get(what, LEAVES if mode == 'SUBTRACT' else TAKES)
    gpu.state.blend_set('ALPHA')
    if shape == 'CIRCLE':
        _draw_in(colour, 'TRI_STRIP', trail(points, radius))
    elif shape != 'CLICK':
        if shape == 'BOX':
            (left, bottom), (right, top) = points[0], points[-1]
            points = [(left, bottom), (right, bottom), (right, top), (left, top)]
        elif shape == 'BALL':
            points = [points[0] + radius * Vector((cos(2 * pi * k / 64), sin(2 * pi * k / 64))) for k in range(64)]
        _draw_in((*colour[:3], LINE), 'LINE_STRIP', [*points, points[0]])
    gpu.state.blend_set('NONE')


def trail(points: list[Vector], radius: float) -> list[tuple[float, float]]:
    """The corners of a strip of triangles that covers what a round brush went over, nearly: from its first place to its last."""
    points = [points[0], *(after for before, after in pairwise(points) if after != before)]
    ways = [after - before for before, after in pairwise(points)] or [Vector((1, 0))]
    corners = []

    def across(middle, way, ahead):
        half = (radius**2 - ahead**2) ** 0.5
        way = way.normalized()
        side = Vector((-way.y, way.x)) * half
        corners.extend((tuple(middle + way * ahead + side), tuple(middle + way * ahead - side)))

    steps = [radius * k / 8 for k in range(9)]
    for ahead in steps[:0:-1]:
        across(points[0], ways[0], -ahead)
    for number, point in enumerate(points):
        across(point, ways[max(number - 1, 0)] + ways[min(number, len(ways) - 1)], 0.0)
    for ahead in steps[1:]:
        across(points[-1], ways[-1], ahead)
    return corners


def _draw_in(colour, kind, points):
    shader = gpu.shader.from_builtin('UNIFORM_COLOR')
    shader.bind()
    shader.uniform_float("color", colour)
    batch_for_shader(shader, kind, {"pos": points}).draw(shader)
