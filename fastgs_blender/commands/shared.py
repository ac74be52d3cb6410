# SPDX-License-Identifier: GPL-3.0-or-later
"""Arguments and output that several subcommands share."""
from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..jobs.job import read_status
from ..training.run.files import MODEL, RUN, STATUS
from ..util.errors import FastGSError
from ..util.progress import progress
from ..util.remarks import remark
from ..util.screen import tell

if TYPE_CHECKING:
    from ..model.sequence import Source
    from ..util.frames import Frames

PROBLEMS, FAILED = 1, 2
"""Exit codes: something is wrong with what was looked at; the command failed.  0: all is well; util/stopping.py has that
of what was stopped."""
STEPS, EVERY = 1000, 0.3
"""Parts of the whole that progress counts, and seconds between two writings of --status' file."""
OWN = "own"
"""The background that a model's decoder shows; a model without one shows black."""
NAMED_COLOURS = {OWN: "#000000", "black": "#000000", "white": "#ffffff", "grey": "#808080", "gray": "#808080"}


def add_device(parser: argparse.ArgumentParser) -> None:
    """--device; its default is $FASTGS_DEVICE, or auto."""
    parser.add_argument("--device", metavar="NAME", help="cpu, gpu, a part of a GPU's name, or auto, the default.  auto is a GPU that was "
                        "faster than the processor in its self-test, and otherwise the processor.  fastgs info --devices lists them")


def add_status(parser: argparse.ArgumentParser) -> None:
    """--status, which stages() writes."""
    parser.add_argument("--status", metavar="FILE", help="a file that tells other programs how far this is, as JSON")


@contextmanager
def shares(what: str, args: argparse.Namespace) -> Iterator[Callable[[float], None]]:
    """A function of the share of the whole that is done, which shows it."""
    with progress(STEPS, "step", what, quiet=args.quiet) as bar:
        yield lambda share: bar.to(int(STEPS * share))


@contextmanager
def stages(what: str, args: argparse.Namespace) -> Iterator[Callable[[str, float], None]]:
    """A function of (stage, share of the whole) that shows how far a command of several stages is, and writes it into --status' file."""
    last = -EVERY
    with progress(STEPS, "step", what, quiet=args.quiet) as bar:

        def tell(stage: str, share: float) -> None:
            nonlocal last
            bar.note(stage)
            bar.to(int(STEPS * share))
            now = time.monotonic()
            if args.status and now - last >= EVERY:
                last = now
                try:
                    Path(args.status).write_text(json.dumps({"stage": stage, "share": round(share, 4)}), "utf-8")
                except OSError as error:
                    raise FastGSError(f"{args.status}: progress cannot be written there ({error.strerror}); choose another "
                                      "file.") from error

        yield tell


def add_backend(parser: argparse.ArgumentParser) -> None:
    """--device, --backend and --threads."""
    add_device(parser)
    parser.add_argument("--backend", default="auto", help="how the processor renders: cpu, reference (slow, double precision) or auto "
                        "(default: what --device says)")
    parser.add_argument("--threads", type=int, metavar="N", help="processor threads to use (default: all)")


def chosen_backend(args: argparse.Namespace) -> str:
    """The backend that --device and --backend mean; says in a line what auto has taken, or why a GPU is not used."""
    if getattr(args, "backend", "auto") != "auto":
        return args.backend
    from ..util.backends import choose_device

    name, about = choose_device(args.device)
    if about:
        note(about)
    return name


def use_threads(count: int | None) -> None:
    """Let rendering use that many threads."""
    if count is None:
        return
    if count < 1:
        raise FastGSError(f"--threads must be at least 1, not {count}.")
    from ..util.threads import set_threads

    set_threads(count)


def image_size(text: str) -> tuple[int, int]:
    """(width, height) of "1920x1080"; raises FastGSError for anything else."""
    from ..cameras.camera import LARGEST_SIDE

    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal() and 0 < int(width) <= LARGEST_SIDE and 0 < int(height) <= LARGEST_SIDE):
        raise FastGSError(f"a size is written WIDTHxHEIGHT, as in 1920x1080, each at most {LARGEST_SIDE}, not {text!r}.")
    return int(width), int(height)


def colour(text: str) -> list[float]:
    """sRGB values 0..1 of #rgb, #rrggbb or a name."""
    digits = NAMED_COLOURS.get(text.lower(), text).removeprefix("#")
    if len(digits) == 3:
        digits = "".join(2 * d for d in digits)
    try:
        if len(digits) != 6:
            raise ValueError
        return [value / 255 for value in bytes.fromhex(digits)]
    except ValueError as error:
        raise FastGSError(f"a colour is written #rrggbb, or is one of {', '.join(NAMED_COLOURS)}, not {text!r}.") from error


def print_json(values: Any) -> None:
    """One JSON document on standard output."""
    json.dump(_unicode(values), sys.stdout, indent=2, allow_nan=False)
    sys.stdout.write("\n")


def _unicode(values: Any) -> Any:
    """The values with lone surrogates in texts written out: JSON has escapes for them, but strict readers refuse those."""
    if isinstance(values, dict):
        return {_unicode(key): _unicode(value) for key, value in values.items()}
    if isinstance(values, (list, tuple)):
        return [_unicode(value) for value in values]
    return values.encode("utf-8", "backslashreplace").decode("utf-8") if isinstance(values, str) else values


def say(text: str) -> None:
    """Print a line of the result on standard output; control characters in texts from files are escaped."""
    tell(text, sys.stdout)


def say_table(text: str) -> None:
    """Print a result of several lines; names from outside in it are printable() already, else they could add lines."""
    for line in text.split("\n"):
        say(line)


def note(text: str) -> None:
    """Print a remark on standard error, unless the command is quiet: standard output is for results."""
    remark(f"fastgs: {text}")


def complain(text: str) -> None:
    """Print on standard error what went wrong."""
    tell(f"fastgs: {text}", sys.stderr)


def model_file(path: str | Path) -> Path:
    """What `path` means: the model in a folder that training wrote, else itself; raises FastGSError where a run has no model yet."""
    path = Path(path)
    if not path.is_dir():
        return path
    file = path / MODEL
    if file.is_file():
        return file
    if is_run(path):
        status = read_status(path / STATUS)
        done, of = status.get("iteration", 0), status.get("iterations", 0)
        how_far = f"{done} of {of} steps are done" if of else "it has not begun"
        raise FastGSError(f"{path}: this training run has no finished model ({how_far}); fastgs train --resume --out {path} continues it.")
    return path


def is_run(path: str | Path) -> bool:
    """Whether a folder is that of a training run."""
    return (Path(path) / RUN).is_file()


def refuse_existing(files: Iterable[Path], args: argparse.Namespace) -> None:
    """Raise FastGSError where one of the files to write has no folder, or is there and --overwrite was not given: before the work."""
    files = list(files)
    homeless = [file for file in files if not file.parent.is_dir()]
    if homeless:
        raise FastGSError(f"{homeless[0]} cannot be written: its folder does not exist; create it first or choose another.")
    taken = [file for file in files if file.exists()]
    if taken and not args.overwrite:
        raise FastGSError(f"{taken[0]} is there already; give another name, or --overwrite to replace it.")


def human_bytes(count: float) -> str:
    """A number of bytes as text, such as 3.4 MB."""
    if count < 1000:
        return f"{count:.0f} bytes"
    power = min(int(len(f"{count:.0f}") - 1) // 3, 4)
    return f"{count / 1000**power:.1f} {('', 'kB', 'MB', 'GB', 'TB')[power]}"


def note_frames_outside(source: Source, frames: Frames) -> None:
    """Say that frames (util.frames.Frames) lie outside of the clip of a model that moves; a sequence shows its last frame there."""
    from ..model.gaussians import GaussianModel

    last = source.clip.frame_count - 1
    if isinstance(source, GaussianModel) and source.basis.terms and not 0 <= min(frames) <= max(frames) < last + 1:
        note(f"the clip has the frames 0 to {last}; outside of these its motion is extrapolated.")
