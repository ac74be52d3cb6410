# SPDX-License-Identifier: GPL-3.0-or-later
"""The subcommands of fastgs.  Each module has add_arguments(parser) and run(args), and imports what is heavy in run."""
from . import (
    align,
    annotate,
    bench,
    cameras,
    check,
    clean,
    completion,
    convert,
    eval,  # noqa: A004 (named as the module is)
    info,
    loop,
    render,
    sync,
    train,
)

COMMANDS = (info, check, convert, clean, annotate, align, loop, cameras, sync, render, train, eval, bench, completion)
