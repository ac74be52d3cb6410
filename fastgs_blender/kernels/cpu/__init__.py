# SPDX-License-Identifier: GPL-3.0-or-later
"""The CPU backend: numba kernels, one module a stage; backend.py puts them together."""
