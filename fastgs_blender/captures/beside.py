# SPDX-License-Identifier: GPL-3.0-or-later
"""Films and folders of pictures that lie beside a calibration, found by the names of its cameras.

A film belongs to a camera if its name is the camera's, or contains it: cam_01, Cam1 and int_cam01_img are the same name, and take2_cam1.mp4
contains it.  The film may also lie in a folder of that name: cam1/GX010010.MP4.  All films of a rig lie in one folder.  Where no name
matches and there are as many films as cameras, they are paired in order, and a note says so.
"""
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from ..cameras import poses
from ..cameras.opencv import Calibrated, metric, upright_axes
from ..util.errors import FastGSError
from .capture import Capture, Options
from .pixels.probe import picture_size
from .pixels.sequences import film_of, films_in, frame_range, holds_pictures, numbered_pictures, video_frames
from .rig_camera import RigCamera
from .rigs import Entry, from_entries, from_rig, lone_sentence
from .sources import PICTURES, VIDEOS, Source
from .timestamps import Times

NOT_A_NAME = ("int", "ext", "img")
"""Words around a camera's name in Pose2Sim's calibrations."""
NOT_CAMERAS = ("masks", "mask")
"""Folders that hold no films, whatever is in them."""
LATER = ("calib", "annotat", "intrinsic", "extrinsic")
"""Folders whose films show a calibration board or what a program drew: looked at after all others."""


def is_film(place: Path) -> bool:
    """Whether a path is a video, or a folder of numbered pictures or with a video in it."""
    if place.name.startswith("."):
        return False
    if place.is_dir():
        return holds_pictures(place) or bool(films_in(place))
    return place.suffix.lower() in VIDEOS and place.is_file()


def first_source(place: Path) -> Source:
    """The first picture of a film."""
    place = film_of(place)
    if place.suffix.lower() in PICTURES:
        return Source(place)
    return Source(place, 0) if place.is_file() else Source(next(iter(numbered_pictures(place).values())))


def words(text: str) -> list:
    """The words and numbers of a name, in lower case; numbers without leading zeros."""
    return [int(part[-18:]) if part.isdigit() else part for part in re.findall(r"[a-z]+|[0-9]+", text.lower())]


def matched(names: Sequence[str], films: Sequence[Path], exact: bool = False) -> dict[str, Path]:
    """The film of each camera that has one; raises FastGSError where two fit equally well.

    exact  the names are those of pictures: IMG_0001 is no film called cam01
    """
    spelt = {film: words(film.stem if film.is_file() else film.name) for film in films}
    found: dict[str, Path] = {}
    for name in names:
        own = [word for word in words(name) if word not in NOT_A_NAME] or words(name)
        rules = (lambda film, name=name: film.stem == name, lambda film, own=own: spelt[film] == own,
                 lambda film, own=own: spelt[film][-len(own):] == own, lambda film, own=own: _holds(spelt[film], own))
        exactly = rules[0], lambda film, name=name: spelt[film] == words(name)
        fits = next((fits for rule in (exactly if exact else rules) if own and (fits := [film for film in films if rule(film)])), [])
        if len(fits) > 1:
            raise FastGSError(f"{fits[0].parent}: {fits[0].name} and {fits[1].name} are both called like camera {name}; leave one of them.")
        if fits:
            found[name] = fits[0]
    twice = next((film for film in found.values() if list(found.values()).count(film) > 1), None)
    if twice is not None:
        both = [name for name, film in found.items() if film == twice]
        raise FastGSError(f"{twice}: it is called like camera {both[0]} and like camera {both[1]}; call each film like its camera.")
    return found


def _holds(whole: list, part: list) -> bool:
    return any(whole[k:k + len(part)] == part for k in range(len(whole) - len(part) + 1))


def films_of(names: Sequence[str], file: Path, path: Path, exact: bool = False) -> tuple[dict[str, Path], list[str]]:
    """The cameras' films in the folder that has most of them, and a note where they are called otherwise and taken in order.

    Looked at are the calibration's folder, the capture's, the folders in them, and those beside the calibration's own folder.
    """
    places = dict.fromkeys([file.parent, path if path.is_dir() else file.parent])
    for place in [*places, *([file.parent.parent] if _later(file.parent) else [])]:
        places |= dict.fromkeys(sorted((p for p in place.iterdir() if p.is_dir() and not p.name.startswith(".")
                                         and p.name.lower() not in NOT_CAMERAS), key=_later))
    best: dict[str, Path] = {}
    counted: list[Path] = []
    for place in sorted(places, key=_later):
        films = sorted(p for p in place.iterdir() if is_film(p))
        found = matched(names, films, exact)
        if len(found) > len(best):
            best = found
        if len(films) == len(names) > 1 and not counted and not exact:
            counted = sorted(films, key=lambda film: [str(word).zfill(18) for word in words(film.stem)])
    if not best and counted and all(len(films_in(film)) < 2 for film in counted if film.is_dir()):
        order = ", ".join(f"{film.name} is {name}" for name, film in zip(names, counted))
        return dict(zip(names, counted)), [f"no film in {counted[0].parent.name} is called like a camera; taken in order, {order}"]
    return best, []


def without_number(called: str) -> str:
    """cam00_0001 and cam00_frame1 -> cam00; cam00 stays."""
    return re.sub(r"(?<=.)[_-](frame_?)?\d+$", "", called, flags=re.IGNORECASE)


def films_of_pictures(pictures: Sequence[str], file: Path, path: Path, several: bool = False) -> tuple[list[str], list[Path | None]]:
    """What each picture's camera is called, and its film if there is one; file and path as films_of() has them.

    The films are called like the pictures, like them without their numbers, or like their folders: as most of them are.  Where several
    pictures share a film or a folder, they were taken on a walk, or lie there: it is none, unless `several`.

    pictures  paths as a calibration has them, without endings
    """
    found: tuple[list[str], list[Path | None]] = [*pictures], [None] * len(pictures)
    for named in (lambda own: own.name, lambda own: without_number(own.name), lambda own: own.parent.name):
        names = [named(PurePosixPath(picture)) for picture in pictures]
        wanted = [name for name, times in Counter(names).items() if name and (several or times == 1)]
        films = films_of(wanted, file, path, exact=True)[0]
        if len(films) > sum(film is not None for film in dict.fromkeys(found[1])):
            found = names, [films.get(name) for name in names]
    return found


def _photographs(names: Sequence[str], file: Path, path: Path) -> dict[str, Path]:
    """The pictures that are called like the cameras, in the calibration's folder, the capture's, and those in them."""
    places = dict.fromkeys([file.parent, path if path.is_dir() else file.parent])
    inside = [p for place in places for p in sorted(place.iterdir()) if p.is_dir() and not p.name.startswith(".")]
    found = {p.stem: p for place in [*places, *inside] for p in sorted(place.iterdir()) if p.suffix.lower() in PICTURES and p.is_file()}
    return {name: found[name] for name in names if name in found}


def _later(place: Path) -> bool:
    return any(word in place.name.lower() for word in LATER)


def capture_of(path: Path, layout: str, file: Path, cameras: Sequence[Calibrated], options: Options, *, unit: float | None = None,
               times: Times | None = None, photographed: bool = False) -> Capture:
    """The capture of a calibration's cameras and the films beside it.

    file   the calibration; path: what the user gave, that file or a folder
    unit   of its lengths in metres, as it says; None: it does not
    photographed  the cameras are photographs' and pictures' of films: named exactly, and without films the photographs are the capture
    times  when each frame was taken, or None: all cameras film frame after frame together
    Raises FastGSError where there are no films, or two cameras are called alike.
    """
    names = [camera.name for camera in cameras]
    poses.check_names(names, file)
    called, notes = names, list[str]()
    if photographed:
        called, streams = films_of_pictures(names, file, path)
        places = {name: film for name, film in zip(names, streams) if film is not None}
    else:
        places, notes = films_of(names, file, path)
    lost = [name for name in names if name not in places]
    if lost and places:
        some = ", ".join(lost[:8]) + (f" and {len(lost) - 8} more" if len(lost) > 8 else "")
        notes += [f"left out for want of a film: {some}"]
    if not places and photographed:
        places = _photographs(names, file, path)
        notes = ["there are no films beside it: its photographs show one moment"]
    if not places:
        raise FastGSError(f"{file}: there is no film of its cameras ({', '.join(names[:8])}) beside it; call each video or folder of "
                          "pictures like its camera.")
    metres, told = metric(cameras, unit)
    notes += [told] if told else []
    faults: list[str] = lone_sentence(list(places), [called for called in names if called not in places])
    start, found, rates = films(places, faults, path)
    rig: dict[str, RigCamera] = {}
    for camera, shown in zip(cameras, called):
        place = places.get(camera.name)
        if place is None:
            continue
        pose = camera.pose.copy()
        pose[:3, 3] *= metres
        settings: dict[str, Any] = dict(lens=camera.lens, intrinsics=camera.intrinsics(_size(place, camera), str(place)))
        pictures = [None if where is None else Source(*where, **settings) for where in found[camera.name]]
        view = place.stem if camera.name.isdecimal() and film_of(place).is_file() else shown  # "cam_0" says more than "0"
        rig[camera.name] = RigCamera(view if view not in names else camera.name, pictures, pose)
    settings = dict(axes=upright_axes([filmed.pose for filmed in rig.values() if filmed.pose is not None]), faults=faults)
    if times is None:
        fps = rates[0] if rates else 30.0
        return from_rig(path, layout, list(rig.values()), options, fps=fps, start_frame=start, notes=notes, **settings)
    entries = []
    for name, filmed in rig.items():
        own, count = times.of(name), len(filmed.pictures)
        if len(own) != count:
            notes.append(f"{filmed.name} has {count} frames and {len(own)} times; the first {min(len(own), count)} of both are used")
        taken = ((image, *when) for image, when in zip(filmed.pictures, own) if image is not None)
        entries += [Entry(filmed.name, frame, image, filmed.pose, t=t) for image, frame, t in taken]
    if not entries:
        raise FastGSError(f"{times.path}: it has no times of the cameras {', '.join(places)}; remove it, or export it with the films.")
    notes.append(f"each frame has its own time, from {times.path.name}")
    return from_entries(path, layout, entries, options, frame_count=times.count, fps=times.fps, notes=notes, **settings)


def films(places: dict[str, Path], faults: list[str], path: Path) -> tuple[int, dict[str, list], list[float]]:
    """The films at these places: number of the first frame, (file, number of its frame) or None by camera and frame, and frames per second
    of the videos."""
    places = {name: film_of(place) for name, place in places.items()}
    folders = {name: numbered_pictures(place) for name, place in places.items() if place.is_dir()}
    start, count = frame_range(folders.values(), path)
    found: dict[str, list] = {name: [(numbered[n], None) if n in numbered else None for n in range(start, start + count)]
                              for name, numbered in folders.items()}
    rates = []
    for name, place in places.items():
        if place.suffix.lower() in PICTURES:
            found[name] = [(place, None)]
        elif name not in found:
            sources, fps = video_frames(place, faults)
            found[name] = [(source.path, source.frame) for source in sources]
            rates += [fps] if fps else []
    return (start if len(folders) == len(places) else 0), found, rates


def _size(place: Path, camera: Calibrated) -> tuple[int, int]:
    try:
        return picture_size(first_source(place))
    except FastGSError:  # said with all other faults
        if camera.size is None:
            raise
        return camera.size
