# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendering a model: the scene to render, the passes, and the oracle that states every equation."""
