# SPDX-License-Identifier: GPL-3.0-or-later
"""render frames of a model to PNG or multi-layer EXR files

Frames are counted from 0; A:B has both ends, A:B:S goes in steps, fractions are sub-frames.  The default is the whole clip.
Frames that the same work has made already are kept, so the same command continues a stopped run.  Where frames of other work lie (another
model, size, camera, background ...), it stops; --overwrite renders them again.

PNG holds the model's display colours (sRGB) with straight alpha, or over --background.  EXR holds scene-linear, premultiplied
R, G, B, A and every other pass as a layer of 32-bit floats (Depth.Z, 1e10 where there is nothing).

Of several cameras --view picks one by name or number.  Without it, as many cameras as frames are a camera path: each frame takes the
next camera.  With --path they are one for any frames: frame f takes camera f.  Else the first camera is used.

--out - writes the PNGs one after another to standard output, for a program that makes a film of them:
    fastgs render model.safetensors --camera path.json --out - |
        ffmpeg -f image2pipe -framerate 30 -i - film.mp4
"""
from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from ..util.errors import FastGSError
from ..util.outputs import make_folder
from ..util.progress import progress
from .shared import OWN, add_backend, chosen_backend, colour, image_size, model_file, note, note_frames_outside, print_json, use_threads

if TYPE_CHECKING:
    import numpy as np

    from ..cameras.camera import Camera
    from ..model.sequence import Source
    from ..rendering.exposure import Exposure

    Image = dict[str, np.ndarray]

STREAM = "-"
"""The folder that stands for standard output."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", metavar="MODEL", help="a model file, or the folder that fastgs train wrote")
    parser.add_argument("--camera", required=True, metavar="CAMERAS", help="a cameras.json, a camera path of another program, "
                        "or a capture")
    parser.add_argument("--frames", metavar="A:B", help="frames to render (default: the whole clip)")
    parser.add_argument("--out", required=True, metavar="DIR", help="folder for the frames, 0000.png and so on; - for standard output")
    parser.add_argument("--format", default="png", choices=("png", "exr"), help="file format (default: png)")
    parser.add_argument("--passes", metavar="P,P", help="EXR: the passes to write (default: all that a model has without meshes)")
    parser.add_argument("--size", metavar="WxH", help="image size (default: the camera's); the horizontal field of view stays the same")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--view", "--camera-index", metavar="NAME", help="the camera to use: its name, or its number from 0")
    which.add_argument("--path", action="store_true", help="the cameras are a path: frame f takes camera f")
    parser.add_argument("--background", metavar="COLOUR", help="an opaque background, #rrggbb in sRGB, or own: what the "
                        "model itself shows where nothing is, as Spacetime Gaussians does, else black (default: transparent)")
    blur = parser.add_argument_group("motion blur and depth of field")
    blur.add_argument("--shutter", type=float, default=0.0, metavar="FRAMES", help="how long the shutter is open around each frame")
    blur.add_argument("--steps", type=int, default=32, metavar="N", help="steps of the motion blur, at the most (default: 32)")
    blur.add_argument("--aperture", type=float, default=0.0, metavar="RADIUS", help="radius of the lens' opening, in the model's units")
    blur.add_argument("--focus", type=float, metavar="DISTANCE", help="distance at which everything is sharp; needed with --aperture")
    blur.add_argument("--lens-samples", type=int, default=64, metavar="N", help="points of the lens, at the most (default: 64)")
    parser.add_argument("--sorting", default="centre", choices=("centre", "pixel"), help="which splats lie in front: all by the depth of "
                        "their centres, or in each pixel by their depth there, which is slower and does not pop (default: centre)")
    parser.add_argument("--no-antialias", action="store_true", help="do not draw splats finer in coarser pixels than the capture's "
                        "cameras had, and softer in finer ones")
    parser.add_argument("--overwrite", action="store_true", help="render frames again that are there already")
    add_backend(parser)


def run(args: argparse.Namespace) -> None:
    from .. import formats
    from ..rendering import cryptomatte, images
    from ..rendering.passes import PASSES
    from ..util.backends import load_backend
    from ..util.frames import parse_frames
    from .kept_frames import KeptFrames
    from .sight import cameras_of_frames, sight

    use_threads(args.threads)
    passes = _passes(args)
    exposure = _exposure(args)
    own = args.background == OWN
    if own and exposure is not None:
        raise FastGSError(f"--background {OWN} goes with sharp frames; leave --shutter and --aperture out, or name a colour.")
    background = None if args.background is None else colour(args.background)
    size = image_size(args.size) if args.size else None
    frames = parse_frames(args.frames) if args.frames is not None else None
    views = sight(args.camera).views
    backend = chosen_backend(args)
    load_backend(backend)
    name = model_file(args.model)
    model = formats.open_source(name)
    if frames is None:
        frames = parse_frames(f"0:{model.clip.frame_count - 1}")
    cameras = cameras_of_frames(views, frames, args, size)
    note_frames_outside(model, frames)

    times = [model.clip.t_of_frame(float(frame)) for frame in frames]
    if args.out == STREAM:
        _render_all(args, backend, model, name.stem, cameras, times, list(range(len(times))), _to_stream(model.colour_space), passes,
                    background, exposure)
        return
    out = Path(args.out)
    make_folder(out, "frames")
    files = [out / f"{frames.label(frame)}.{args.format}" for frame in frames]
    blur = {} if exposure is None else {"exposure": [args.shutter, args.steps, args.aperture, args.focus, args.lens_samples]}
    drawing = ({"antialias": False} if args.no_antialias else {}) | ({} if args.sorting == "centre" else {"sorting": args.sorting})
    drawing |= {"film": "opaque"} if own else {}
    options = {"passes": passes, "background": background, "backend": args.backend} | blur | drawing
    notes = KeptFrames(out, model, options)
    states = [notes.state(*each) for each in zip(files, cameras, times, strict=True)]
    if "other" in states and not args.overwrite:
        raise FastGSError(f"{files[states.index('other')]} is there already, and was not made by this command with this model and these "
                          f"options ({states.count('other')} of {len(files)} frames); give another folder, or --overwrite to render "
                          "them again.")
    todo = [i for i, state in enumerate(states) if args.overwrite or state != "same"]
    kept = len(files) - len(todo)
    if kept:
        note(f"{kept} of {len(files)} frames are there already and are kept; --overwrite renders them again.")

    def write(i: int, image: Image) -> None:
        with notes.written(files[i], cameras[i], times[i]):
            if args.format == "png":
                images.write_png(files[i], image, model.colour_space)
            else:
                attributes = {"comments": f"frame {frames.numbers[i]} of {name.name}; scene-linear Rec. 709, premultiplied"}
                if any(PASSES[each].exr[0].startswith(cryptomatte.LAYER) for each in passes):
                    attributes |= cryptomatte.metadata([name.stem])
                images.write_exr(files[i], image, model.colour_space, passes, attributes)

    start = time.perf_counter()
    _render_all(args, backend, model, name.stem, cameras, times, todo, write, passes, background, exposure)
    if args.json:
        print_json({
            "model": args.model, "frames": [float(frame) for frame in frames], "files": [str(file) for file in files],
            "rendered": len(todo), "kept": kept, "seconds": round(time.perf_counter() - start, 3),
        })


def _to_stream(colour_space: str) -> Callable[[int, Image], None]:
    """A function of a frame's number and its image that writes it to standard output as a PNG."""
    from ..rendering.images import png

    def write(_: int, image: Image) -> None:
        sys.stdout.buffer.write(png(image, colour_space))
        sys.stdout.buffer.flush()

    return write


def _render_all(args: argparse.Namespace, backend: str, model: Source, name: str, cameras: list[Camera], times: list[float],
                todo: list[int], write: Callable[[int, Image], None], passes: tuple[str, ...], background: list[float] | None,
                exposure: Exposure | None) -> None:
    import numpy as np

    from ..rendering.api import render
    from ..rendering.instances import Instance, ObjectSettings
    from ..rendering.passes import PassSettings

    wanted = tuple(dict.fromkeys((*passes, "alpha")))
    look, film = ObjectSettings(antialias=not args.no_antialias), "opaque" if args.background == OWN else "transparent"
    settings = PassSettings(sorting=args.sorting, film=film)
    with progress(len(todo), "frame", "rendering", quiet=args.quiet) as bar:
        try:
            for done, i in enumerate(todo):
                bar.to(done)
                shown, t = model.moment(times[i])
                scene = [Instance(shown, np.eye(4), t, look, name=name)]
                image = render(scene, cameras[i], passes=wanted, backend=backend, settings=settings, exposure=exposure)
                write(i, image if background is None else _over(image, background, model.colour_space))
                bar.to(done + 1)
        except KeyboardInterrupt:
            bar.close()
            rest = "." if args.out == STREAM else f" to {args.out}, and the same command continues from there."
            raise KeyboardInterrupt(f"stopped; {bar.n} of {len(todo)} frames are written{rest}") from None


def _exposure(args: argparse.Namespace) -> Exposure | None:
    """The Exposure of the options, or None for sharp frames."""
    from ..rendering.exposure import Aperture, Exposure

    if not (args.shutter >= 0 and args.aperture >= 0):
        raise FastGSError("--shutter and --aperture take numbers from 0 up.")
    if args.aperture and not (args.focus and args.focus > 0):
        raise FastGSError("--aperture needs --focus, a distance above 0 at which everything is sharp.")
    lens = Aperture(args.aperture, args.focus, samples=args.lens_samples) if args.aperture else None
    return Exposure(-args.shutter / 2, args.shutter / 2, steps=args.steps, aperture=lens) if args.shutter or lens else None


def _passes(args: argparse.Namespace) -> tuple[str, ...]:
    from ..rendering.passes import PASSES

    if args.out == STREAM and (args.format != "png" or args.json):
        raise FastGSError("frames go to standard output as PNG, and nothing else does; leave out --format exr and --json.")
    if args.format == "png":
        if args.passes is not None:
            raise FastGSError("a PNG holds colour and alpha only; --passes needs --format exr.")
        return ("rgb", "alpha")
    if args.passes is None:
        return tuple(name for name, entry in PASSES.items() if entry.level < 3 and not entry.meshes)
    passes = tuple(dict.fromkeys(name.strip() for name in args.passes.split(",") if name.strip()))
    unknown = [name for name in passes if name not in PASSES]
    if unknown or not passes:
        raise FastGSError(f"--passes {args.passes!r} names no known pass; there are {', '.join(PASSES)}.")
    return passes


def _over(image: Image, background: list[float], colour_space: str) -> Image:
    """The image with an opaque background, blended in the model's own space like everything else in it."""
    import numpy as np

    from ..rendering.colour import over, srgb_to_linear

    srgb = np.array(background, np.float32)
    if "rgb" not in image:
        return image
    ground = srgb if colour_space == "srgb" else srgb_to_linear(srgb)
    return {**image, "rgb": over(image["rgb"], image["alpha"], ground), "alpha": np.ones_like(image["alpha"])}
