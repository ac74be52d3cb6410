# SPDX-License-Identifier: GPL-3.0-or-later
"""What every other part of the library uses: errors, files, threads."""
