# SPDX-License-Identifier: GPL-3.0-or-later
"""The layouts of captures on disk, one module each."""
