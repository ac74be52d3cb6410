# SPDX-License-Identifier: GPL-3.0-or-later
"""The backend for GPUs of any maker, through WebGPU: shaders in WGSL, one file a stage, and the Python that dispatches them."""
