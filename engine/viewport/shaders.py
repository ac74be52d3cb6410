# SPDX-License-Identifier: GPL-3.0-or-later
"""Compiles the shaders, with the rectangle that each is drawn on."""
from contextlib import contextmanager
from functools import cache

import gpu
from gpu_extras.batch import batch_for_shader

from ...fastgs_blender.kernels import gl
from .covering import FRAGMENT as COVERING_FRAGMENT

CORNERS = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)]


@cache
def splats(features: bool, own: bool):
    """(shader, batch) that blends splats: their colour, or nine features; if `own`, also their own share of alpha,
    their depth and their mark."""
    info = gpu.types.GPUShaderCreateInfo()
    between = gpu.types.GPUStageInterfaceInfo("fastgs_splat_iface")
    between.smooth('VEC2', "v_uv")
    between.flat('VEC4', "v_alpha")
    between.flat('VEC3', "v_first")
    between.flat('VEC3', "v_own")
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
    return _finish(info, gl.SPLAT_VERTEX, gl.SPLAT_FRAGMENT)


@cache
def resolve(features: bool, own: bool, sky: bool):
    """(shader, batch) that turns blended splats into scene-linear colour; `sky`: the background is a panorama."""
    info = _whole("fastgs_resolve_iface")
    names = ["t_resolve", "t_first"]
    if features:
        info.define("FEATURES")
        names += ["t_second", "t_third"]
    if own:
        info.define("OWN")
        names.append("t_own")
    if sky:
        info.define("SKY")
        names.append("t_sky")
    _samplers(info, names)
    return _finish(info, gl.RESOLVE_VERTEX, gl.RESOLVE_FRAGMENT)


@cache
def show(deep: bool, fading: bool = False, ordered: bool = False):
    """(shader, batch) that puts a picture of its size into the active viewport; `deep`: with its depth; `fading`: a share of it;
    `ordered`: where it lies behind another deep one, or where it does not."""
    info = _whole("fastgs_show_iface")
    names = ["t_shown"]
    if fading:
        info.define("FADING")
        info.push_constant('FLOAT', "share")
        info.push_constant('FLOAT', "rest")
        names.append("t_over")
    if deep:
        _deep(info)
        names += ["t_resolve", "t_own"]
    if ordered:
        info.define("ORDERED")
        info.push_constant('FLOAT', "newer")
        names.append("t_other")
    _samplers(info, names)
    return _finish(info, gl.RESOLVE_VERTEX, gl.SHOW_FRAGMENT)


@cache
def covering():
    """(shader, batch) that takes overlays away where splats lie before them."""
    info = _whole("fastgs_covering_iface")
    _deep(info)
    _samplers(info, ("t_covering", "t_own"))
    return _finish(info, gl.RESOLVE_VERTEX, COVERING_FRAGMENT)


def clear():
    """Free the shaders."""
    for made in (splats, resolve, show, covering):
        made.cache_clear()


def _whole(name):
    """The beginning of a shader that fills the window with one colour a pixel."""
    info = gpu.types.GPUShaderCreateInfo()
    between = gpu.types.GPUStageInterfaceInfo(name)
    between.smooth('VEC2', "v_uv")
    info.vertex_in(0, 'VEC2', "corner")
    info.vertex_out(between)
    info.fragment_out(0, 'VEC4', "out_colour")
    return info


def _deep(info):
    info.define("DEEP")
    if hasattr(info, "depth_write"):  # Blender 4.5 and later; OpenGL, which is all that earlier ones have beside Metal, infers it
        info.depth_write('ANY')


def _samplers(info, names):
    for slot, name in enumerate(names):
        info.sampler(slot, 'FLOAT_2D', name)


def _finish(info, vertex, fragment):
    info.vertex_source(vertex)
    info.fragment_source(fragment)
    shader = gpu.shader.create_from_info(info)
    return shader, batch_for_shader(shader, 'TRI_STRIP', {"corner": CORNERS})


def fill(shader, batch, inputs):
    """Draw a shader over the whole of the active framebuffer; its textures must live until then."""
    bind(shader, inputs)
    batch.draw(shader)


def bind(shader, inputs):
    """Bind a shader and its textures, which are named in the order of their slots.

    Slot 0 comes last: with OpenGL, Blender 5.3.0 puts the texture that is bound last there too.
    """
    shader.bind()
    for name, texture in reversed(inputs.items()):
        shader.uniform_sampler(name, texture)


@contextmanager
def drawing(blend, depth_test='NONE', writes_depth=False):
    """Blending, depth test and whether depth is written as wanted; as Blender expects it afterwards."""
    before = gpu.state.blend_get(), gpu.state.depth_test_get(), gpu.state.depth_mask_get()
    gpu.state.blend_set(blend)
    gpu.state.depth_test_set(depth_test)
    gpu.state.depth_mask_set(writes_depth)
    try:
        yield
    finally:
        gpu.state.blend_set(before[0])
        gpu.state.depth_test_set(before[1])
        gpu.state.depth_mask_set(before[2])
