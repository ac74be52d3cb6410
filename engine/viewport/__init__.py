# SPDX-License-Identifier: GPL-3.0-or-later
"""Splats in Blender's 3D viewports, drawn by the GPU."""
