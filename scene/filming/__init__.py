# SPDX-License-Identifier: GPL-3.0-or-later
"""Filming the open scene: a copy of it that may be changed at will, what in it moves, and the pictures that become a capture."""
