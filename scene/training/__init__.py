# SPDX-License-Identifier: GPL-3.0-or-later
"""Training from inside Blender: jobs in processes of their own, which Python runs them, what they train on, what is shown of them."""
