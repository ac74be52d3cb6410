# SPDX-License-Identifier: GPL-3.0-or-later
"""The backend for GPUs of any make, through WebGPU: shaders in WGSL, one file a stage, and what calls them."""
