# SPDX-License-Identifier: GPL-3.0-or-later
"""`.splat4d` of splats4D: frames of .splat files as its own description encodes them, within the bounds that it promises.

Transcribed from adamraudonis/splats4D@bf7c41a, docs/FORMAT.md, lines 100-145; its decoder normalises quaternions (line 140).
"""
from __future__ import annotations

import json
import struct

import mutations
import numpy as np
import pytest
import zstandard

import fastgs_blender as fg

N, FRAMES, GROUP = 21, 7, 3
STEPS = {"pos": 0.01, "scale_log": 0.04, "rgb": 9, "alpha": 9, "rot": 3, "base_pos": 0.005, "base_scale_log": 0.02}
NAMES, CHANNELS = ("pos", "rot", "rgb", "alpha", "scale_log"), (3, 4, 3, 1, 3)


def stream(attribute: int, kind: int, codes) -> tuple[bytes, bytes]:
    """Header and payload."""
    codes = np.asarray(codes).reshape(-1)
    width = next(w for w in (1, 2, 4) if codes.max(initial=0) < 256**w)
    payload = zstandard.compress(codes.astype(f"<u{width}").view(np.uint8).reshape(-1, width).T.tobytes())
    return struct.pack("<BBBII", attribute, kind, width, len(codes), len(payload)), payload


def zigzag(values):
    return np.where(values >= 0, 2 * values, -2 * values - 1)


def clip(rng) -> list[np.ndarray]:
    """For each attribute whole numbers [FRAMES, N, C] in its step, half of them changing; the first Gaussian is of a base step's place."""
    found = []
    for attribute, (low, high) in enumerate(((-300, 300), (-42, 42), (0, 29), (0, 29), (-120, -30))):
        first = rng.integers(low, high, (1, N, CHANNELS[attribute]))
        moved = np.clip(first + np.cumsum(rng.integers(-2, 3, (FRAMES, N, CHANNELS[attribute])), 0), low, high - 1)
        keep = np.arange(N) % 2 == attribute % 2
        found.append(np.where(keep[None, :, None], first, moved))
    return found


def file(values, groups=GROUP) -> bytes:
    """A file of version 1."""
    changing = [np.flatnonzero((v != v[:1]).any((0, 2))) for v in values]
    parts = []
    for places in changing:
        mask = np.ones(N, np.uint8)
        mask[places] = 0
        parts.append(stream(0, 2, np.packbits(mask)))
    parts += [stream(a, 2, zigzag(np.diff(2 * values[a][0], axis=0, prepend=0))) for a in (0, 4)]  # base steps are half as long
    colours = [np.clip(values[a][0] * STEPS[NAMES[a]], 0, 255) for a in (2, 3)]
    parts += [stream(2, 2, colours[0]), stream(3, 2, colours[1]), stream(1, 2, values[1][0] * STEPS["rot"] + 128)]
    static = b"".join(head + payload for head, payload in parts)
    chunks, spans = [], []
    for first in range(0, FRAMES, groups):
        last = min(first + groups, FRAMES) - 1
        moved = [(a, values[a][first:last + 1, places]) for a, places in enumerate(changing)]
        listed = [stream(a, 0, zigzag(v[0])) for a, v in moved]
        listed += [stream(a, 1, zigzag(np.diff(v, axis=0))) for a, v in moved if last > first]
        chunks.append(struct.pack("<H", len(listed)) + b"".join(h for h, _ in listed) + b"".join(p for _, p in listed))
        spans.append({"f0": first, "f1": last, "t0": first / 20, "t1": last / 20})
    header = {"n": N, "t": FRAMES, "fps": 20.0, "gop": groups, "steps": STEPS, "denoised": False}
    text = b""
    for _ in range(3):  # places depend on the header's length
        begin = 12 + len(text)
        at = begin + len(static)
        for span, chunk in zip(spans, chunks):
            span |= {"offset": at, "len": len(chunk)}
            at += len(chunk)
        text = json.dumps(header | {"static_section": {"offset": begin, "len": len(static)}, "gops": spans}).encode().ljust(1200)
    return struct.pack("<4sHHI", b"SP4D", 1, 0, len(text)) + text + static + b"".join(chunks)


@pytest.mark.parametrize("groups", [GROUP, 1, 30])
def test_each_frame_is_what_its_description_says(tmp_path, rng, groups):
    values = clip(rng)
    (tmp_path / "m.splat4d").write_bytes(file(values, groups))
    source = fg.open_source(tmp_path / "m.splat4d")
    assert (source.clip, len(source)) == (fg.Clip(FRAMES, 20.0), N)
    for f in (0, 4, 5, 1, 6, 2):  # on, back, and in other groups
        s = fg.slice_model(source.moment(source.clip.t_of_frame(f))[0], 0, cull=False)
        np.testing.assert_allclose(s.position, values[0][f] * STEPS["pos"], atol=1e-6)
        np.testing.assert_allclose(np.log(s.scale), values[4][f] * STEPS["scale_log"], atol=1e-5)
        np.testing.assert_allclose(s.features, np.clip(values[2][f] * 9, 0, 255) / 255, atol=1e-6)
        np.testing.assert_allclose(s.opacity, np.clip(values[3][f][:, 0] * 9, 0, 255) / 255, atol=1e-6)
        q = values[1][f] * 3 / 128
        np.testing.assert_allclose(np.abs(np.sum(s.rotation * q / np.linalg.norm(q, axis=1, keepdims=True), 1)), 1, atol=1e-6)
    place = [fg.slice_model(source.moment(source.clip.t_of_frame(f))[0], 0, cull=False).position for f in (2, 2.5, 3)]
    np.testing.assert_allclose(place[1], (place[0] + place[2]) / 2, atol=1e-6)


@pytest.mark.parametrize(("old", "new", "said"), [
    (b'"n": 21', b'"n": 29', "numbers of"), (b'"t": 7', b'"t": 8', "groups hold 7 frames"), (b'"f0": 3', b'"f0": 4', "groups.*follow"),
    (b'"pos": 0.01', b'"pox": 0.01', "numbers should be"), (b"SP4D\1", b"SP4D\2", "version 2")])
def test_damage_has_a_name(tmp_path, rng, old, new, said):
    (tmp_path / "m.splat4d").write_bytes(file(clip(rng)).replace(old, new))
    with pytest.raises(fg.FastGSError, match=said):
        fg.open_source(tmp_path / "m.splat4d")


def test_mutated_files(tmp_path, rng):
    values = clip(rng)
    seeds = {f"groups of {groups}": {"m.splat4d": file(values, groups)} for groups in (3, 30)}
    told = mutations.campaign("splats4d", mutations.shows("m.splat4d"), seeds, tmp_path)
    assert min(told.values(), default=1) > 0
