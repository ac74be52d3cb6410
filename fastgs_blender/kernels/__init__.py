# SPDX-License-Identifier: GPL-3.0-or-later
"""Backends that render and train: their interface (protocol.py) and the CPU's implementation (cpu/)."""
