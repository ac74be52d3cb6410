# SPDX-License-Identifier: GPL-3.0-or-later
"""Training jobs: a queue of processes that outlive the program that started them.  No bpy here."""
