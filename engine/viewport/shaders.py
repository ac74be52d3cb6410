# SPDX-License-Identifier: GPL-3.0-or-later
"""Compiles the shaders, with the rectangle that each is drawn on."""
from __future__ import annotations

from functools import cache

import gpu
from gpu_extras.batch import batch_for_shader

from . import glsl

CORNERS = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)]


@cache
def splats(features: bool, own: bool):
    """(shader, batch) that blends splats: their colour, or nine features; with their own share of alpha if `own`."""
    info = gpu.types.GPUShaderCreateInfo()
    between = gpu.types.GPUStageInterfaceInfo("fastgs_splat_iface")
    between.smooth('VEC2', "v_uv")
    between.flat('VEC4', "v_alpha")
    between.flat('VEC3', "v_first")
    between.flat('FLOAT', "v_own")
    info.vertex_in(0, 'VEC2', "corner")
    outputs = ["out_first"]
    if features:
        info.define("FEATURES")
        between.flat('VEC3', "v_second")
        between.flat('VEC3', "v_third")
        outputs += ["out_second", "out_third"]
    if own:
        info.define("OWN")
        outputs.append("out_own")
    info.vertex_out(between)
    _samplers(info, ("t_table", "t_order", "t_geometry", "t_colour", "t_depth"))
    for slot, name in enumerate(outputs):
        info.fragment_out(slot, 'VEC4', name)
    return _finish(info, glsl.SPLAT_VERTEX, glsl.SPLAT_FRAGMENT)


@cache
def resolve(features: bool, own: bool):
    """(shader, batch) that turns blended splats into scene-linear colour."""
    info = gpu.types.GPUShaderCreateInfo()
    between = gpu.types.GPUStageInterfaceInfo("fastgs_resolve_iface")
    between.smooth('VEC2', "v_uv")
    info.vertex_in(0, 'VEC2', "corner")
    info.vertex_out(between)
    names = ["t_resolve", "t_first"]
    if features:
        info.define("FEATURES")
        names += ["t_second", "t_third"]
    if own:
        info.define("OWN")
        names.append("t_own")
    _samplers(info, names)
    info.fragment_out(0, 'VEC4', "out_colour")
    return _finish(info, glsl.RESOLVE_VERTEX, glsl.RESOLVE_FRAGMENT)


def clear():
    """Free the shaders."""
    splats.cache_clear()
    resolve.cache_clear()


def _samplers(info, names):
    for slot, name in enumerate(names):
        info.sampler(slot, 'FLOAT_2D', name)


def _finish(info, vertex, fragment):
    info.vertex_source(vertex)
    info.fragment_source(fragment)
    shader = gpu.shader.create_from_info(info)
    return shader, batch_for_shader(shader, 'TRI_STRIP', {"corner": CORNERS})
