# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes and refreshes splat objects and their proxies."""
