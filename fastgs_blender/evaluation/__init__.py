# SPDX-License-Identifier: GPL-3.0-or-later
"""How close a model's pictures come to the truth: the measures of the literature, and the report of a whole model."""
