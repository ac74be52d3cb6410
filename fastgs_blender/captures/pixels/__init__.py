# SPDX-License-Identifier: GPL-3.0-or-later
"""The pixels of a capture: reading, decoding, caching and checking pictures and videos."""
