# SPDX-License-Identifier: GPL-3.0-or-later
"""Web pages that play a scene: one HTML file, which asks for nothing else."""
