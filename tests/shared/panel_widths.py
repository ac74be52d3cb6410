# SPDX-License-Identifier: GPL-3.0-or-later
"""How wide panels are, in pixels, in Blender's startup file at an interface scale of 1, by their kind of region.

The sidebar of the 3D view ('UI') has the same width in every window, the properties editor ('WINDOW') that of a window 1920 pixels wide.
tests/blender measures both; tests/addon asks whether all texts fit.
"""
REGIONS = {'UI': 291, 'WINDOW': 303, 'HEADER': 220}
"""Of regions, in the release where they are narrowest (4.3; 5.2 has 292 and 309)."""
WIDTHS = {'UI': 236, 'WINDOW': 269, 'HEADER': 200}
"""From the left edge of a panel's buttons to their right edge."""
