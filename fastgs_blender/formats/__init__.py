# SPDX-License-Identifier: GPL-3.0-or-later
"""File formats."""
def load(path): raise NotImplementedError
def save(model, path): raise NotImplementedError
