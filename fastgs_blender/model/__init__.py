# SPDX-License-Identifier: GPL-3.0-or-later
"""The 4D Gaussian model: its arrays, its kinds of motion, lifetime and appearance, and slicing it at a time."""
