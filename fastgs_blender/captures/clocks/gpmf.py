# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads from a GoPro's telemetry (GPMF) when its first frame was taken, by the satellites' clock.

A film's timecode is the camera's own clock, which a user sets: in GoPro's sample of a Max it is 40 s off.  The telemetry is a track of
payloads, about one a second, of nested entries, big-endian, each padded to 4 bytes (github.com/gopro/gpmf-parser describes it):

    key [4], type [1], size of a value [1], count of values [2], values        type 0: the values are entries
    DEVC > STRM > GPSU  "yymmddhhmmss.sss" of the payload, with GPSF (2, 3: satellites are found) and GPSP (100 times the imprecision)
    DEVC > STRM > GPS9  since HERO11: values of "lllllllSS"; the sixth counts days since 2000, the seventh milliseconds since midnight, the
                        last two are 100 times the imprecision and what GPSF says
"""
import struct
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from ..pixels.video import telemetry

PAYLOADS, LEAST = 12, 3
"""Payloads that are read at most, and that must have a time."""
FOUND, IMPRECISE = 2, 500
"""GPSF from which the time counts, and GPSP from which it does not."""
SPREAD = 0.2
"""Seconds by which the payloads' times may differ at the median.  They are right to some hundredths; the first is often seconds off."""
EPOCH = datetime(2000, 1, 1, tzinfo=UTC)


def first_frame_utc(path: Path) -> float | None:
    """Seconds from the beginning of 2000 (UTC) to a film's first frame; None where its telemetry does not tell.

    Raises FastGSError where the film cannot be read.
    """
    begun = [utc - seconds for seconds, payload in telemetry(path, b"DEVC", PAYLOADS) if (utc := _utc(payload)) is not None]
    if len(begun) < LEAST:
        return None
    middle = float(np.median(begun))
    return middle if np.median(np.abs(np.array(begun) - middle)) < SPREAD else None


def _utc(payload: bytes) -> float | None:
    """The time of a payload's first value; None where no satellites are found."""
    for key, _, device in entries(payload):
        for inner, _, stream in entries(device) if key == b"DEVC" else ():
            if inner == b"STRM" and (utc := _of_stream({name: value for name, _, value in entries(stream)})) is not None:
                return utc
    return None


def _of_stream(found: dict[bytes, bytes]) -> float | None:
    with suppress(struct.error, ValueError):  # cut short, or no date
        if b"GPS9" in found:
            *_, days, milliseconds, imprecision, fix = struct.unpack_from(">7l2H", found[b"GPS9"])
            utc = 86_400.0 * days + milliseconds / 1000
        elif b"GPSU" in found:
            fix, imprecision = struct.unpack(">L", found[b"GPSF"])[0], struct.unpack(">H", found.get(b"GPSP", b"\0\0"))[0]
            date, _, rest = found[b"GPSU"].decode("ascii").partition(".")
            utc = (datetime.strptime(date, "%y%m%d%H%M%S").replace(tzinfo=UTC) - EPOCH) / timedelta(seconds=1) + float(f"0.{rest}")
        else:
            return None
        return utc if fix >= FOUND and imprecision < IMPRECISE else None
    return None


def entries(data: bytes) -> Iterator[tuple[bytes, bytes, bytes]]:
    """(key, type, values) of the entries in these bytes; one that claims more than there is ends them."""
    at = 0
    while at + 8 <= len(data):
        key, kind, size, count = struct.unpack_from(">4scBH", data, at)
        length = size * count
        if at + 8 + length > len(data):
            return
        yield key, kind, data[at + 8:at + 8 + length]
        at += 8 + (length + 3) // 4 * 4
