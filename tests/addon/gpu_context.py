# SPDX-License-Identifier: GPL-3.0-or-later
"""A GPU for tests in the bpy wheel, which has no window."""
from __future__ import annotations

import ctypes
import os

import pytest


def has_egl() -> bool:
    """Whether there is an EGL driver, hardware or Mesa's.  Blender asked for a GPU without one ends the process."""
    try:
        egl = ctypes.CDLL("libEGL.so.1")
    except OSError:
        return False
    egl.eglInitialize.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p]
    egl.eglGetProcAddress.restype = egl.eglGetDisplay.restype = ctypes.c_void_p
    egl.eglGetDisplay.argtypes = [ctypes.c_void_p]
    displays = []
    by_platform = egl.eglGetProcAddress(b"eglGetPlatformDisplayEXT")
    if by_platform:
        call = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_uint, ctypes.c_void_p, ctypes.c_void_p)(by_platform)
        displays.append(call(0x31DD, None, None))  # EGL_PLATFORM_SURFACELESS_MESA
    displays.append(egl.eglGetDisplay(None))
    return any(display and egl.eglInitialize(display, None, None) for display in displays)


_opened = []


def open_gpu(scene):
    """Let the gpu module work in this process from now on; skips the test where no GPU can be had."""
    import bpy

    if not has_egl():
        if os.environ.get("REQUIRE_GPU") == "1":
            pytest.fail("there is no EGL driver, and REQUIRE_GPU=1 wants one")
        pytest.skip("there is no EGL driver, so no GPU for Blender")
    if not _opened:
        # before 5.2 has gpu.init(), a render by an engine that asks for a GPU context is what makes one

        class FASTGS_test_unlock(bpy.types.RenderEngine):
            bl_idname = "FASTGS_test_unlock"
            bl_label = "Opens the GPU"
            bl_use_gpu_context = True

            def render(self, depsgraph):
                self.end_result(self.begin_result(0, 0, 8, 8))

        bpy.utils.register_class(FASTGS_test_unlock)
        _opened.append(True)
        before = scene.render.engine, scene.render.resolution_x, scene.render.resolution_y
        scene.render.engine, scene.render.resolution_x, scene.render.resolution_y = "FASTGS_test_unlock", 8, 8
        camera = bpy.data.objects.new("Opens the GPU", bpy.data.cameras.new("Opens the GPU"))
        scene.collection.objects.link(camera)
        scene.camera = camera
        bpy.ops.render.render()
        bpy.data.cameras.remove(camera.data)
        scene.render.engine, scene.render.resolution_x, scene.render.resolution_y = before


def draw_offscreen(width: int, height: int, function):
    """Call a drawing function with an empty offscreen buffer bound; returns float32 [h, w, 4], the top row first."""
    import gpu
    import numpy as np

    offscreen = gpu.types.GPUOffScreen(width, height, format='RGBA32F')
    with offscreen.bind():
        framebuffer = gpu.state.active_framebuffer_get()
        framebuffer.clear(color=(0.0, 0.0, 0.0, 0.0), depth=1.0)
        function(framebuffer)
        buffer = framebuffer.read_color(0, 0, width, height, 4, 0, 'FLOAT')
        buffer.dimensions = width * height * 4
        image = np.frombuffer(memoryview(buffer), np.float32).copy().reshape(height, width, 4)
    offscreen.free()
    return image[::-1]
