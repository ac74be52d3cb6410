# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras: the pinhole, lenses, camera files, paths and moves."""
