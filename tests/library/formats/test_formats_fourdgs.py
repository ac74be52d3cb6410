# SPDX-License-Identifier: GPL-3.0-or-later
"""`.4dgs` against its specification's formulas, on files written here, and against its own package on real ones.

avala-ai/4dgs@30f5d0f, website/docs/spec/index.md, sections 3, 5 and 6; its rotations are unit quaternions, which readers renormalise (6.4).
"""
from __future__ import annotations

import struct
import sys
import zlib

import fourdgs as package
import mutations
import numpy as np
import pytest
import zstandard
from evaluated import assert_shows, directions, spherical
from fourdgs import keyframe_delta_file

import fastgs_blender as fg
from fastgs_blender.util import rotations

MAGIC = b"\x894DGS1\r\n"
STEPS = {"pos": 0.01, "scale_log": 0.1, "rot": 0.01, "rgb": 1 / 255, "alpha": 1 / 255, "motion": 0.02, "time": 1 / 128, "sigma_log": 0.05}
ORIGIN = np.array([0.5, -0.25, 2.0])
WINDOWS = np.array([[0.0, 4.0], [0.5, 2.0], [1.0, 3.5]])
DURATION, CUTOFF, N = 4.0, 0.08, 12
CHANNELS = {0: 3, 1: 3, 2: 1, 3: 3, 4: 3, 5: 1, 6: 3, 7: 1, 8: 1, 9: 1, 10: 1}


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def stream(attribute: int, values: np.ndarray, mode: int = 0, width: int = 4, codec: int = 0) -> bytes:
    values = np.asarray(values, np.int64).reshape(len(values), -1)
    stored = np.diff(values, axis=0, prepend=0) if mode == 1 else values[:1] if mode == 2 else values
    code = np.where(stored >= 0, 2 * stored, -2 * stored - 1).reshape(-1).astype(f"<u{width}")
    planes = code.view(np.uint8).reshape(-1, width).T.tobytes()
    payload = zstandard.compress(planes) if codec == 1 else zlib.compress(planes)
    return struct.pack("<5BIQ", attribute, width, mode, codec, values.shape[1], len(values), len(payload)) + payload


PACKED = {"": bytes, "deflate": zlib.compress, "zstd": zstandard.compress}


def chunk(table, packed_with: str = "", begin=0.0, end=DURATION, codec=0, **modes) -> bytes:
    body = b"".join(stream(a, v, modes.get(f"mode{a}", 0), codec=codec) for a, v in table.items())
    packed = PACKED[packed_with](body)
    count = len(table[9]) if 9 in table else 0
    head = struct.pack("<ddII", begin, end, 0, count) + text(packed_with)
    return record(5, head + struct.pack("<QQ", len(body), len(packed)) + packed)


def delta(begin, end, mode, reference, keyframe, updates, births, deaths) -> bytes:
    def block(table):
        body = b"".join(stream(a, v) for a, v in table.items())
        return struct.pack("<Q", len(body)) + body

    counts = [len(t[13]) if 13 in t else 0 for t in (updates, births, deaths)]
    body = block(updates) + block(births) + block(deaths)
    head = struct.pack("<ddIBQQHIII", begin, end, 0, mode, reference, keyframe, 1, *counts) + text("")
    return record(16, head + struct.pack("<QQ", len(body), len(body)) + body)


def header(temporal_model="gaussian-birth", degree=0, count=N, duration=DURATION) -> bytes:
    grids = text("uniform-v1") + struct.pack("<3d8dB", *ORIGIN, *STEPS.values(), 1) + struct.pack("<I", 0)
    head = text("") + text("a test") + struct.pack("<dQd", duration, count, CUTOFF) + text(temporal_model)
    head += struct.pack("<6dBB", *np.zeros(6), degree, 0) + struct.pack("<I", 0)
    windows = struct.pack("<I", len(WINDOWS)) + WINDOWS.tobytes()
    return MAGIC + record(1, head) + record(3, grids) + record(4, windows)


def scene(*parts: bytes, **kinds) -> bytes:
    return header(**kinds) + b"".join(parts) + record(2, bytes(20)) + MAGIC


def table(rng, n=N) -> dict[int, np.ndarray]:
    """Random attributes in integers, every kind of Gaussian among them."""
    out = {0: rng.integers(-200, 200, (n, 3)), 1: rng.integers(-40, -10, (n, 3)), 2: rng.integers(0, 4, (n, 1)),
           3: rng.integers(-50, 50, (n, 3)), 5: rng.integers(20, 255, (n, 1)),
           4: np.stack([rng.integers(60, 200, n), rng.integers(-50, 50, n), rng.integers(-50, 50, n)], 1),
           6: rng.integers(-40, 40, (n, 3)), 7: rng.integers(0, 400, (n, 1)), 8: rng.integers(-80, 20, (n, 1)),
           9: (np.arange(n) % 3 == 0).astype(int)[:, None], 10: rng.integers(0, 3, (n, 1))}
    return {a: np.asarray(v, np.int64) for a, v in out.items()}


def state(bins, time: float, bands=(), along: bool = False) -> dict:
    """The specification's sections 3 and 6, one Gaussian after the other; along: sorted by x."""
    rows = []
    for i in range(len(bins[9])):
        b = {a: v[i].astype(float) for a, v in bins.items()}
        lo, hi = WINDOWS[int(b[10][0])]
        sigma = np.exp(b[8][0] * STEPS["sigma_log"])
        always = int(b[9][0]) == 1
        half = min(max(hi - lo if always else np.sqrt(-2 * np.log(CUTOFF)) * sigma, 0.02), 2.0)
        kind = min(max(np.ceil(np.log2(half / 0.5)), -4), 2)
        velocity = b[6] * STEPS["motion"] * 2.0 ** -kind
        target = STEPS["time"] if always else min(STEPS["time"], 0.05 * sigma)
        mu = b[7][0] * STEPS["time"] * 2.0 ** min(max(np.floor(np.log2(target / STEPS["time"])), -10), 0)
        marginal = 1.0 if always else np.exp(-0.5 * ((time - mu) / sigma) ** 2)
        visible = lo <= time < hi and marginal >= CUTOFF
        q = np.insert(np.clip(b[3] * STEPS["rot"], -1, 1), int(b[2][0]), 0)
        q[int(b[2][0])] = np.sqrt(max(0, 1 - np.sum(q**2)))
        g, r, blue = b[4]
        rgb = np.clip(np.array([r + g, g, blue + g]) * STEPS["rgb"], 0, 1)
        rows.append((b[0] * STEPS["pos"] + ORIGIN + velocity * (time - mu), q[[3, 0, 1, 2]], np.exp(b[1] * STEPS["scale_log"]),
                     min(b[5][0] * STEPS["alpha"], 1) * marginal * visible, rgb))
    position, rotation, scale, opacity, rgb = (np.array(column) for column in zip(*rows))
    coefficients = [((rgb - 0.5) / 0.28209479177387814)[:, None]]
    coefficients = np.concatenate([*coefficients, *((-4 + v * 8 / 255).reshape(len(v), 3, -1).transpose(0, 2, 1) for v in bands)], 1)
    told = {"position": position, "rotation": rotation, "scale": scale, "opacity": opacity, "coefficients": coefficients}
    if along:
        told = {key: value[np.argsort(position[:, 0])] for key, value in told.items()}
    return told | {"colour": spherical(directions(len(rows)), told.pop("coefficients"))}


def written(tmp_path, data: bytes):
    path = tmp_path / "a.4dgs"
    path.write_bytes(data)
    return path


TIMES = (-0.1, 0.0, 0.3, 0.71, 1.2, 1.999, 2.6, 3.49, 3.9, 4.2)


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_gaussian_birth(tmp_path, rng, degree):
    """Two chunks, one of them compressed as a whole, unknown records and attributes in between, every mode of streams."""
    a, b = table(rng), table(rng)
    b[7][:] = 130
    b[64] = np.zeros((N, 5), int)
    bands = [[rng.integers(0, 256, (N, 3 * (2 * k + 1))) for k in range(1, degree + 1)] for _ in range(2)]
    records = [[record(7, struct.pack("<B", k) + stream(7, v, width=2)) for k, v in enumerate(band, 1)] for band in bands]
    data = scene(chunk(a, mode0=1, mode7=1), *records[0], record(0x90, b"private"), chunk(b, "deflate", mode7=2), *records[1],
                 degree=degree)
    model = fg.load(written(tmp_path, data))
    b.pop(64)
    bins = {k: np.concatenate([a[k], b[k]]) for k in a}
    assert model.clip.duration == pytest.approx(DURATION)
    for time in TIMES:
        assert_shows(model, time / DURATION, **state(bins, time, [np.concatenate(v) for v in zip(*bands)]))


def test_streams_and_chunks_packed_with_zstd(tmp_path, rng):
    bins = table(rng)
    whole, parts = (fg.load(written(tmp_path, scene(data))) for data in (chunk(bins, "zstd"), chunk(bins, codec=1, mode7=1)))
    for model in (whole, parts):
        for time in TIMES[::3]:
            assert_shows(model, time / DURATION, **state(bins, time))


def test_windows_do_not_overlap(tmp_path, rng, monkeypatch):
    """At the frame where one window ends and the next begins there is exactly one of the two."""
    bins = table(rng, 30)
    for a, v in ((9, 1), (5, 200), (10, np.arange(30)[:, None])):
        bins[a][:] = v
    monkeypatch.setattr(sys.modules[__name__], "WINDOWS", np.array([[i / 30, (i + 1) / 30] for i in range(30)]))
    model = fg.load(written(tmp_path, scene(chunk(bins), duration=1.0)))
    for frame in range(30):
        seen = fg.slice_model(model, model.clip.t_of_frame(frame), cull=False).opacity > 0
        assert np.flatnonzero(seen).tolist() == [frame]


def test_keyframe_delta(tmp_path, rng):
    """Keyframes, chained and keyframe-referenced deltas, births and deaths."""
    name = np.array([5, 2**31 + 3, 9, 40, 7])
    wide = np.where(name >= 2**31, name - 2**32, name)[:, None]

    def fill(n):
        bins = table(rng, n)
        bins[9][:] = 1
        bins[10][:] = 0
        return bins

    def harmonics(n):
        return rng.integers(0, 256, (n, 9))

    def band(values):
        return record(7, struct.pack("<B", 1) + stream(7, values, width=2))

    whole, extra, again = fill(5), fill(2), fill(3)
    sh, sh_extra, sh_again = harmonics(5), harmonics(2), harmonics(3)
    head = header("keyframe-delta", 1)
    first = len(head)
    parts = [chunk(whole | {13: wide}, begin=0.0, end=1.0), band(sh)]
    moved, colour = rng.integers(-20, 20, (2, 3)), rng.integers(-3, 3, (2, 3))
    parts.append(delta(1.0, 2.0, 1, first, first, {13: wide[[3, 0]], 0: moved, 4: colour, 2: [[1], [2]], 3: [[1, 2, 3], [4, 5, 6]]},
                       extra | {13: [[100], [101]]}, {13: wide[[1]]}))
    parts.append(band(sh_extra))
    parts.append(delta(2.0, 3.0, 0, first, first, {13: wide[[2]], 5: [[-7]]}, {}, {13: wide[[4]]}))
    last = chunk(again | {13: [[1], [2], [3]]}, begin=3.0, end=4.0) + band(sh_again)
    data = head + b"".join(parts) + last + record(2, bytes(20)) + MAGIC
    model = fg.load(written(tmp_path, data))

    def edited(bins, rows, changes, absolute=()):
        bins = {a: v.copy() for a, v in bins.items()}
        for a, values in changes.items():
            bins[a][rows] = values if a in absolute else bins[a][rows] + values
        return bins

    one = edited(whole, [3, 0], {0: moved, 4: colour, 2: [[1], [2]], 3: [[1, 2, 3], [4, 5, 6]]}, (2, 3))
    one = {a: np.concatenate([np.delete(v, 1, 0), extra[a]]) for a, v in one.items()}
    two = {a: np.delete(v, 4, 0) for a, v in edited(whole, [2], {5: [[-7]]}).items()}
    expected = [(0.5, whole, sh), (1.5, one, np.concatenate([np.delete(sh, 1, 0), sh_extra])), (2.4, two, np.delete(sh, 4, 0)),
                (3.7, again, sh_again)]
    for time, bins, harmonic in expected:
        seen = model.take(fg.slice_model(model, time / DURATION, cull=False).opacity > 0)
        order = np.argsort(fg.slice_model(seen, time / DURATION, cull=False).position[:, 0])
        assert_shows(seen.take(order), time / DURATION, **state(bins, time, [harmonic], along=True))
    assert not fg.slice_model(model, 1.001, cull=False).opacity.any()
    assert len(model) == 5 + 4 + 4 + 3  # what is the same in two states is one Gaussian


@pytest.mark.parametrize("interpolation", [0, 1])
def test_object_tracks(tmp_path, rng, interpolation):
    bins = table(rng) | {14: (np.arange(N) % 3)[:, None]}
    bins[8][:] = 20
    times = np.array([0.5, 1.5, 3.0])
    q, move = rotations.unit(rng.normal(size=(3, 4))), rng.normal(size=(3, 3))
    poses = b"".join(struct.pack("<8d", t, *q[i][[1, 2, 3, 0]], *move[i]) for i, t in enumerate(times))
    track = record(0x25, struct.pack("<IBI", 2, interpolation, 3) + poses)
    model = fg.load(written(tmp_path, scene(track, chunk(bins))))
    bins.pop(14)
    for time in (0.2, 0.6, 1.1, 1.7, 2.9, 3.4):
        at = max(0, np.searchsorted(times, time, side="right") - 1)
        to = min(at + 1, 2)
        share = 0.0 if interpolation or to == at else np.clip((time - times[at]) / (times[to] - times[at]), 0, 1)
        second = q[to] * (1 if q[at] @ q[to] > 0 else -1)
        angle = np.arccos(min(1, q[at] @ second))
        turn = q[at] if angle < 1e-9 else (np.sin((1 - share) * angle) * q[at] + np.sin(share * angle) * second) / np.sin(angle)
        told, mine = state(bins, time), np.arange(N) % 3 == 2
        matrix = rotations.to_matrices(turn)
        told["position"][mine] = told["position"][mine] @ matrix.T + (1 - share) * move[at] + share * move[to]
        told["rotation"][mine] = rotations.multiply(np.tile(turn, (mine.sum(), 1)), rotations.unit(told["rotation"][mine]))
        assert_shows(model, time / DURATION, **told)


def test_frame_of_reference(tmp_path, rng):
    for hand, up, axes in ((1, 1, "RUB"), (0, 2, "RFU"), (1, 4, "RDF")):
        frame = record(0x20, text("") + struct.pack("<4Bd", hand, up, 0, 0, 0.0))
        assert fg.load(written(tmp_path, scene(frame, chunk(table(rng))))).axes == axes
    with pytest.warns(fg.LossWarning, match="left-handed"):
        fg.load(written(tmp_path, scene(record(0x20, text("") + struct.pack("<4Bd", 2, 1, 0, 0, 0.0)), chunk(table(rng)))))


def hollow(count: int, codec: str) -> bytes:
    """A chunk without streams."""
    return record(5, struct.pack("<ddII", 0, 1, 0, count) + text(codec) + struct.pack("<QQ", 0, 0))


def without(bins, *attributes):
    return {a: v for a, v in bins.items() if a not in attributes}


@pytest.mark.parametrize(("change", "said"), [
    (lambda b: scene(chunk(b), temporal_model="splines"), "'splines'"),
    (lambda b: scene(chunk(b))[:-8], "cut short"),
    (lambda b: scene(chunk(b | {10: b[10] + 2})), "has window"),
    (lambda b: scene(chunk(without(b, 6))), "no motion"),
    (lambda b: scene(chunk(b | {2: b[2] + 4})), "component"),
    (lambda b: scene(hollow(10**9, "")), "claims 1000000000 Gaussians"),
    (lambda b: scene(hollow(1, "lzma")), "'lzma'"),
    (lambda b: scene(chunk(b, codec=1).replace(b"\x28\xb5\x2f\xfd", b"\x28\xb5\x2f\xfe", 1)), "stream.*unpacked"),
    (lambda b: scene(chunk(b | {0: b[0][:-1]}, codec=1)), "has 11 elements"),
    (lambda b: scene(chunk(b), chunk(b)).replace(record(4, struct.pack("<I", 3) + WINDOWS.tobytes()), b""), "has window"),
    (lambda b: scene(header()[8:], chunk(b)), "one header"),
    (lambda b: scene(chunk(b), degree=2), "harmonics.*missing"),
    (lambda b: scene(record(16, b""), chunk(b)), "delta chunk"),
])
def test_damage_has_a_name(tmp_path, rng, change, said):
    with pytest.raises(fg.FastGSError, match=said):
        fg.load(written(tmp_path, change(table(rng))))


def test_damaged_files(tmp_path, rng):
    bins = table(rng, 4)
    named = bins | {13: np.arange(4)[:, None]}
    head = header("keyframe-delta", 1)
    band = record(7, b"\1" + stream(7, np.full((4, 9), 99), width=1))
    states = head + chunk(named, begin=0, end=2) + band + delta(2, 4, 1, len(head), len(head), {13: [[1]], 0: [[3, 4, 5]]}, {}, {13: [[2]]})
    poses = struct.pack("<8d", 0, 0, 0, 0, 1, 0, 0, 0) + struct.pack("<8d", 1, 0, 0, 1, 0, 1, 2, 3)
    track = record(0x25, struct.pack("<IBI", 1, 0, 2) + poses)
    contents = {"birth": scene(chunk(bins), record(7, b"\1" + stream(7, np.full((4, 9), 99), width=1)), degree=1),
                "states": states + record(2, bytes(20)) + MAGIC,
                "zstd": scene(chunk(bins, codec=1), chunk(bins, "zstd")),
                "tracks": scene(track, chunk(bins | {14: np.array([[0], [1], [1], [0]])}, "deflate"))}
    mutations.campaign("fourdgs", mutations.shows("m"), {key: {"m": content} for key, content in contents.items()}, tmp_path)


REFUSED = {"EmptyTemporalModel": "temporal model.*''", "UnknownStreamCodec": "codec 9", "WindowIndexOutOfRange": "has window"}


def test_the_conformance_files(shared_data):
    files = sorted((shared_data / "4dgs").glob("*.4dgs"))
    assert len(files) == 30
    for path in files:
        said = REFUSED.get(path.stem)
        if said:
            with pytest.raises(fg.FastGSError, match=said):
                fg.load(path)
        else:
            assert len(fg.load(path)) > 0 or path.stem.startswith("NoData")


def test_against_its_own_package(shared_data):
    for path in sorted((shared_data / "4dgs").glob("*.4dgs")):
        if path.stem in REFUSED or path.stem.startswith("KeyframeDelta"):
            continue
        theirs, model = package.read(path), fg.load(path)
        g = theirs.gaussians
        for time in (0.0, *np.random.default_rng(1).uniform(0, theirs.duration_sec, 12)):
            now = theirs.state_at(time)
            seen, opacity = np.asarray(now["indices"], int), np.zeros(len(model))
            opacity[seen] = now["opacity"]
            s = fg.slice_model(model, time / model.clip.duration, cull=False)
            np.testing.assert_allclose(s.opacity, opacity, atol=1e-4)
            np.testing.assert_allclose(s.position[seen], now["centers"], atol=1e-4)
            q = np.asarray(now["orientations"])[:, [3, 0, 1, 2]]
            np.testing.assert_allclose(np.abs((q * s.rotation[seen]).sum(1)), 1, atol=1e-6)
            np.testing.assert_allclose(s.scale, g.scales, atol=1e-4)
            if g.sh is not None:
                code = np.asarray(g.sh, float).reshape(len(model), 3, -1)
                ours = s.features.reshape(len(model), -1, 3)[:, 1:].transpose(0, 2, 1)
                np.testing.assert_allclose(ours, -4 + code * 8 / 255, atol=1e-4)


def test_keyframe_delta_against_its_own_package(shared_data, monkeypatch):
    monkeypatch.setattr(keyframe_delta_file, "_check_keyframe_mu_t", lambda *_: None)  # their older files have no such times
    for path in sorted((shared_data / "4dgs").glob("KeyframeDelta*.4dgs")):
        decoded, model = keyframe_delta_file.decode_streamed(path.read_bytes()), fg.load(path)
        for c in decoded.chunks:
            for time in (c.t0, 0.5 * (c.t0 + c.t1)):
                told = keyframe_delta_file.render_at(decoded, time)
                s = fg.slice_model(model, time / model.clip.duration, cull=False)
                seen = s.opacity > 0
                mine, theirs = np.argsort(s.position[seen] @ [1, 1e-3, 1e-6]), np.argsort(told["centers"] @ [1, 1e-3, 1e-6])
                np.testing.assert_allclose(s.position[seen][mine], told["centers"][theirs], atol=1e-4)
                np.testing.assert_allclose(s.opacity[seen][mine], told["opacity"][theirs], atol=1e-4)
                np.testing.assert_allclose(s.scale[seen][mine], told["scales"][theirs], atol=1e-4)
