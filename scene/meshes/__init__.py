# SPDX-License-Identifier: GPL-3.0-or-later
"""Bakes meshes into 4D Gaussians: their surface, their materials' colour and their light."""
