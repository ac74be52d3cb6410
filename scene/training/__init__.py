# SPDX-License-Identifier: GPL-3.0-or-later
"""Training from inside Blender: options, captures from the scene's cameras, the queue of jobs, and display of runs and results."""
