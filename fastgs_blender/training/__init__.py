# SPDX-License-Identifier: GPL-3.0-or-later
"""Training: models from multi-view image sequences.  Nothing here is imported for rendering."""
