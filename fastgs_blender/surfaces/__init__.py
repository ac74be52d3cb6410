# SPDX-License-Identifier: GPL-3.0-or-later
"""From animated meshes to 4D Gaussians, without training."""
