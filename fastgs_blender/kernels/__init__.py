# SPDX-License-Identifier: GPL-3.0-or-later
"""The fast kernels.  One module a stage; cpu.py puts them together."""
