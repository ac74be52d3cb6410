# SPDX-License-Identifier: GPL-3.0-or-later
"""A training run on disk: its folder, checkpoints, segments and progress."""
