# SPDX-License-Identifier: GPL-3.0-or-later
"""Selecting Gaussians: by shapes in the picture, by what they are, by what belongs together; what had better be hidden.

Each function gives [N] bool of a model's Gaussians.  A selection becomes a part of the model (model/parts.py) or is hidden (a mask).
"""
