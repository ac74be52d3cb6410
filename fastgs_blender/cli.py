# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line fastgs: its parser, and how errors and warnings of its commands are shown."""
import argparse
import contextlib
import inspect
import os
import sys
import textwrap
import traceback
import warnings
from collections.abc import Iterator
from typing import Any, NoReturn

from . import __version__
from .commands import COMMANDS
from .commands.shared import FAILED, PROBLEMS, complain, note
from .util.errors import FastGSError, LossWarning, printable_lines
from .util.remarks import be_quiet
from .util.stopping import STOPPED, as_interrupts

EPILOG = f"""\
fastgs COMMAND --help tells more.

Exit codes: 0 all is well; {PROBLEMS} fastgs info or check found problems; {FAILED} the command failed, one sentence says why;
{STOPPED} it was stopped.  Results go to standard output, progress and remarks to standard error."""


class Paragraphs(argparse.HelpFormatter):
    """Wraps each paragraph by itself; indented lines stay as they are."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        parts = []
        for paragraph in inspect.cleandoc(text).split("\n\n"):
            lines: list[str] = []
            for line in paragraph.splitlines():
                if line.startswith(" ") or not lines or lines[-1].startswith(" "):
                    lines.append(line)
                else:
                    lines[-1] += " " + line
            parts.append("\n".join(line if line.startswith(" ") else textwrap.fill(line, width) for line in lines))
        return textwrap.indent("\n\n".join(parts), indent)


class Parser(argparse.ArgumentParser):
    """Tells of wrong arguments as commands tell of their errors."""

    def error(self, message: str) -> NoReturn:
        self.print_usage(sys.stderr)
        complain(message if message.endswith(".") else f"{message}.")
        self.exit(FAILED)


def parser() -> argparse.ArgumentParser:
    """The whole command line; nothing heavy is imported for it."""
    common = Parser(add_help=False)
    common.add_argument("--json", action="store_true", help="print the result as JSON on standard output")
    common.add_argument("--quiet", action="store_true", help="show no progress and no remarks, only results and errors")
    common.add_argument("--debug", action="store_true", help="show where in the program an error came from")
    top = Parser(
        prog="fastgs", description="4D Gaussian models: train, look at, convert, render and measure them.", epilog=EPILOG,
        formatter_class=Paragraphs)
    top.add_argument("--version", action="version", version=f"fastgs {__version__}")
    top.set_defaults(command=None, parser=top)
    commands = top.add_subparsers(metavar="COMMAND")
    for module in COMMANDS:
        name = module.__name__.rpartition(".")[2]
        command = commands.add_parser(
            name, parents=[common], help=(module.__doc__ or "").splitlines()[0], description=module.__doc__, formatter_class=Paragraphs)
        module.add_arguments(command)
        command.set_defaults(run=module.run, command=name)
    return top


def main(argv: list[str] | None = None) -> int:
    """Run one command; returns the exit code: 0, 1 where problems were found, 2 for an error told in one sentence, 130 when stopped."""
    with as_interrupts():
        return _main(argv)


def _main(argv: list[str] | None) -> int:
    for stream in (sys.stdout, sys.stderr):  # names from files may hold letters that a terminal's encoding lacks
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    debug = False
    try:
        top = parser()
        if "_ARGCOMPLETE" in os.environ:  # a shell asks what may follow
            import argcomplete

            argcomplete.autocomplete(top)
        args = top.parse_args(argv)
        if args.command is None:
            args.parser.print_help()
            return 0
        debug = args.debug
        be_quiet(args.quiet)
        with _losses_as_remarks():
            return args.run(args) or 0
    except KeyboardInterrupt as stop:
        return _tell(str(stop) or "stopped.", STOPPED, debug)
    except BrokenPipeError:  # the reader of our output has gone, for example `| head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except FastGSError as error:
        return _tell(str(error), FAILED, debug)
    except MemoryError:
        return _tell("there is not enough memory for this; use a smaller image or model, or close other programs.", FAILED, debug)
    except OSError as error:
        name = f"{error.filename}: " if error.filename else ""
        return _tell(f"{name}{error.strerror or error}.", FAILED, debug)
    finally:
        be_quiet(False)


@contextlib.contextmanager
def _losses_as_remarks() -> Iterator[None]:
    """Print a LossWarning as a remark to the user, not as a warning about our program."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", LossWarning)
        usual = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *rest: Any) -> None:
            if issubclass(category, LossWarning):
                note(f"lost: {message}")
            else:
                usual(message, category, *rest)

        warnings.showwarning = show  # type: ignore[assignment]
        yield


def _tell(sentence: str, code: int, debug: bool) -> int:
    if debug:
        sys.stderr.write(printable_lines(traceback.format_exc()))
    with contextlib.suppress(OSError):  # the terminal was closed
        complain(sentence)
    return code
