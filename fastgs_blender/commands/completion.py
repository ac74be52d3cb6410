# SPDX-License-Identifier: GPL-3.0-or-later
"""print a script that completes fastgs in a shell

Let your shell read it when it starts:
    bash   echo 'source <(fastgs completion bash)' >> ~/.bashrc
    zsh    echo 'source <(fastgs completion zsh)' >> ~/.zshrc
    fish   fastgs completion fish > ~/.config/fish/completions/fastgs.fish
"""
from __future__ import annotations

import argparse

SHELLS = ("bash", "zsh", "fish")
BASH = """\
_fastgs() {{
    local current=${{COMP_WORDS[COMP_CWORD]}} words="" previous=${{COMP_WORDS[COMP_CWORD-1]}}
    if [[ $COMP_CWORD == 1 ]]; then
        words="{commands} --help --version"
    else
        case "${{COMP_WORDS[1]}} $previous" in
{choices}
        *) case "${{COMP_WORDS[1]}}" in
{options}
        esac ;;
        esac
    fi
    COMPREPLY=($(compgen -W "$words" -- "$current"))
    if [[ $COMP_CWORD -gt 1 && $current != -* ]]; then
        COMPREPLY+=($(compgen -f -- "$current"))
    fi
}}
complete -o filenames -F _fastgs fastgs
"""


def add_arguments(parser):
    parser.add_argument("shell", choices=SHELLS, help="the shell")


def run(args):
    print(script(args.parser, args.shell), end="")


def script(parser: argparse.ArgumentParser, shell: str) -> str:
    """The script for a shell, from the whole command line's parser."""
    commands = _subparsers(parser)
    if shell == "fish":
        return _fish(commands)
    choices = "\n".join(f"        '{name} {flag}') words=\"{' '.join(map(str, action.choices))}\" ;;"
                        for name, command in commands.items() for action in _actions(command) if action.choices
                        for flag in action.option_strings)
    options = "\n".join(f"        {name}) words=\"{' '.join(flag for action in _actions(command) for flag in action.option_strings)}\" ;;"
                        for name, command in commands.items())
    text = BASH.format(commands=" ".join(commands), choices=choices, options=options)
    return "autoload -U +X bashcompinit && bashcompinit\n" + text if shell == "zsh" else text


def _fish(commands: dict[str, argparse.ArgumentParser]) -> str:
    names = " ".join(commands)
    lines = []
    for name, command in commands.items():
        about = _quoted((command.description or "").splitlines()[0])
        lines.append(f"complete -c fastgs -n 'not __fish_seen_subcommand_from {names}' -f -a {name} -d {about}")
        for action in _actions(command):
            flags = " ".join(f"-l {flag.removeprefix('--')}" for flag in action.option_strings if flag.startswith("--"))
            values = f" -x -a {_quoted(' '.join(map(str, action.choices)))}" if action.choices and flags else ""
            if flags:
                lines.append(f"complete -c fastgs -n '__fish_seen_subcommand_from {name}' {flags}{values} -d {_quoted(action.help or '')}")
    return "\n".join(lines) + "\n"


def _subparsers(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    return next(dict(action.choices) for action in _actions(parser) if isinstance(action, argparse._SubParsersAction))


def _actions(parser: argparse.ArgumentParser) -> list[argparse.Action]:
    return parser._actions  # argparse has no other way to ask


def _quoted(text: str) -> str:
    return "'" + text.replace("%%", "%").replace("\\", "").replace("'", "") + "'"
