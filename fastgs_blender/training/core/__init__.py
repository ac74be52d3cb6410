# SPDX-License-Identifier: GPL-3.0-or-later
"""The training loop: trainer, optimiser, losses, density control."""
