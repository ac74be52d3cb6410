# SPDX-License-Identifier: GPL-3.0-or-later
"""Synchronises cameras that are not genlocked: finds their clock offsets from sound, flashes or motion, and stores them in sync.json."""
