# SPDX-License-Identifier: GPL-3.0-or-later
"""Modules that every other part of the library uses: errors, reading and writing files, pictures, rotations, threads."""
