# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's cameras: keyframes, the space of camera files, undistorted pictures."""
