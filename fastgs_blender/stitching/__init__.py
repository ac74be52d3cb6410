# SPDX-License-Identifier: GPL-3.0-or-later
"""Putting captures together: aligning two of them, grading one to the other, and cutting a clip so that it loops."""
