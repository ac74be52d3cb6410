# SPDX-License-Identifier: GPL-3.0-or-later
"""Starting points for training: triangulated, swept, or given."""
