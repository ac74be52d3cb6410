# SPDX-License-Identifier: GPL-3.0-or-later
"""Web pages of `fastgs convert`: their options, and how one is written."""
from __future__ import annotations

import argparse
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..util.errors import FastGSError, LossWarning
from .shared import OWN, colour

if TYPE_CHECKING:
    from ..model.chapters import Chapters
    from ..model.gaussians import GaussianModel

OPTIONS = ("title", "sound", "background", "camera", "view", "path", "once", "limit")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    page = parser.add_argument_group("web pages (.html)")
    page.add_argument("--title", metavar="TEXT", help="the page's title (default: the model's name)")
    page.add_argument("--sound", metavar="FILE", help="a sound file that the page plays with the model (.m4a, .mp3, .ogg, .wav ...)")
    page.add_argument("--background", metavar="COLOUR", help="the page's background, #rrggbb in sRGB (default: black)")
    page.add_argument("--camera", metavar="CAMERAS", help="the opening view: a cameras.json, a capture, or a camera path of another "
                      "program, which becomes the opening move (default: the view that the file names, or a camera of its capture)")
    which = page.add_mutually_exclusive_group()
    which.add_argument("--view", metavar="NAME", help="the camera to use: its name, or its number from 0")
    which.add_argument("--path", action="store_true", help="the cameras are a path: frame f takes camera f")
    page.add_argument("--once", action="store_true", help="play the clip once instead of in a loop")
    page.add_argument("--limit", type=float, metavar="MB", help="write no page that is larger than this")


def is_page(target: Path) -> bool:
    """Whether a file to write is a web page."""
    return target.name.lower().endswith(".html")


def check_options(target: Path, args: argparse.Namespace) -> None:
    """Raises FastGSError where options for pages are given for another file, or do not fit together."""
    given = [name for name in OPTIONS if getattr(args, name) not in (None, False)]
    if given and not is_page(target):
        raise FastGSError(f"--{given[0]} is for web pages; name the file to write .html, or leave it out.")
    if (args.view or args.path) and not args.camera:
        raise FastGSError("--view and --path choose among the cameras of --camera; name those as well.")
    if args.limit is not None and not args.limit > 0:
        raise FastGSError(f"--limit takes a number of MB above 0, not {args.limit:g}.")


def write(model: GaussianModel | Chapters, target: Path, args: argparse.Namespace, progress: Callable[[float], None]) -> None:
    """Write the page of a model as the options say; LossWarnings say what it loses."""
    import numpy as np

    from ..formats import web
    from ..model.chapters import Chapters
    from ..rendering.colour import srgb_to_linear

    options: dict[str, Any] = {"title": args.title or Path(args.input).stem, "loop": not args.once}
    if args.background is not None:
        if args.background == OWN:
            raise FastGSError(f"a page has one background; name a colour for --background instead of {OWN}.")
        options["background"] = srgb_to_linear(np.array(colour(args.background)))
    if args.sound is not None:
        options["sound"] = web.sound_of(args.sound)
    if args.camera is not None:
        options |= _cameras(model, args)
    loss = web.FINE if args.compress is None else web.Loss.of(args.compress)
    if isinstance(model, Chapters):
        _write_clip(model, target, args, loss, options, progress)
        return
    kept = web.kept_file(Path(args.input)) if args.compress is None and unchanged(args) else None
    lost = [] if kept else web.WebPage(loss).losses(model)
    if lost:
        warnings.warn(LossWarning(f"{target} cannot hold everything as a web page: {'; '.join(lost)}."), stacklevel=2)
    web.save_page(web.page_of(model, **options), target, loss, args.limit, progress, {model: kept} if kept else None)


def _write_clip(source: Chapters, target: Path, args: argparse.Namespace, loss: Any, options: dict[str, Any],
                progress: Callable[[float], None]) -> None:
    """write() of a long clip."""
    from ..formats import native, web

    with tempfile.TemporaryDirectory(prefix="fastgs-") as folder:
        path, lost = Path(args.input), []
        if args.compress is not None or args.then or args.chapters is not None or not web.is_compressed(path):
            path = Path(folder) / "clip.safetensors"
            lost = native.Native(loss, progress).write_chapters(source, path)
        page, packed = web.clip_page(path, **options)
        if lost:
            warnings.warn(LossWarning(f"{target} cannot hold everything as a web page: {'; '.join(lost)}."), stacklevel=3)
        web.save_page(page, target, loss, args.limit, progress, packed)


def unchanged(args: argparse.Namespace) -> bool:
    """Whether the model is written as its file has it."""
    return args.at is None and args.prune is None and not args.antialias


def _cameras(model: GaussianModel | Chapters, args: argparse.Namespace) -> dict[str, Any]:
    """The page's cameras and its pivot, as --camera, --view and --path say."""
    import numpy as np

    from ..util.frames import parse_frames
    from .sight import cameras_of_frames, sight

    found = sight(args.camera)
    cameras = cameras_of_frames(found.views, parse_frames(f"0:{model.clip.frame_count - 1}"), args, None)
    still = all(camera is cameras[0] for camera in cameras)
    pose = np.linalg.inv(cameras[0].world_to_camera)
    distance = (found.centre - pose[:3, 3]) @ pose[:3, 2]
    pivot = pose[:3, 3] + distance * pose[:3, 2] if distance > 0 else found.centre
    return {"cameras": cameras[:1] if still else cameras, "pivot": pivot}
