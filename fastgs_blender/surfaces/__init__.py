# SPDX-License-Identifier: GPL-3.0-or-later
"""Turns animated meshes into 4D Gaussians, without training."""
