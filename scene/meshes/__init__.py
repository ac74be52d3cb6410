# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes to bake: their surface, material colour and light."""
