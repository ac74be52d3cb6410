# SPDX-License-Identifier: GPL-3.0-or-later
"""Splat objects and their proxies: making and refreshing them."""
