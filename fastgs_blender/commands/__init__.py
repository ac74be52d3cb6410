# SPDX-License-Identifier: GPL-3.0-or-later
"""The subcommands of fastgs.  Each module has add_arguments(parser) and run(args), and imports what is heavy in run."""
from . import annotate, bench, cameras, completion, convert, eval, info, render, train  # noqa: A004 (a command is named as its module is)

COMMANDS = (info, convert, annotate, cameras, render, train, eval, bench, completion)
