# SPDX-License-Identifier: GPL-3.0-or-later
"""Starting points for training, from triangulated features, plane sweeps, files or models; and camera poses by pycolmap."""
