# SPDX-License-Identifier: GPL-3.0-or-later
"""The subcommands of fastgs.  Each module has add_arguments(parser) and run(args), and imports what is heavy in run."""
from . import bench, convert, info, render

COMMANDS = (info, convert, render, bench)
