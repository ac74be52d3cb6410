# SPDX-License-Identifier: GPL-3.0-or-later
"""The equations that all shaders share, each in one text: WGSL that text.py also turns into GLSL."""
