# SPDX-License-Identifier: GPL-3.0-or-later
"""The version of the library and of the extension; blender_manifest.toml repeats it."""
VERSION = "0.1.0"
