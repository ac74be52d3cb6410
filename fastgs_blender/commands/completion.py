# SPDX-License-Identifier: GPL-3.0-or-later
"""print a script that completes fastgs in a shell

Let your shell read it when it starts:
    bash   echo 'source <(fastgs completion bash)' >> ~/.bashrc
    zsh    echo 'source <(fastgs completion zsh)' >> ~/.zshrc
    fish   fastgs completion fish > ~/.config/fish/completions/fastgs.fish

The Python package argcomplete does it; pip install argcomplete installs it.
"""
import argparse

from ..util.errors import FastGSError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("shell", choices=("bash", "zsh", "fish"), help="the shell")


def run(args: argparse.Namespace) -> None:
    try:
        import argcomplete
    except ImportError as error:
        raise FastGSError("the Python package argcomplete, which completes commands, is not installed; install it.") from error
    print(argcomplete.shellcode(["fastgs"], shell=args.shell))
