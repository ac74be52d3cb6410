# SPDX-License-Identifier: GPL-3.0-or-later
"""Training of models from multi-view image sequences.  Rendering imports nothing from here."""
