# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders the open scene from many cameras to make a capture: a private copy of the scene, its moving subject, the pictures."""
