# SPDX-License-Identifier: GPL-3.0-or-later
"""The subcommands of fastgs.  Each module has add_arguments(parser) and run(args), and imports what is heavy in run."""
from . import annotate, bench, cameras, check, clean, completion, convert, eval, info, render, reproduce, sync, train  # noqa: A004 (named as the module is)

COMMANDS = (info, check, convert, clean, annotate, cameras, sync, render, train, eval, reproduce, bench, completion)
