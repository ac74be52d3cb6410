# SPDX-License-Identifier: GPL-3.0-or-later
"""Both `.sog4d` against their programs' formulas in float64, on files written here.

Transcribed from forgrabbit/supersplat4d@219eb07 (branch splat4d), src/shaders/splat-shader.ts, lines 138-154 and 285-297, and from
raiscui/gsplat-unity@a92f847, Runtime/Shaders/GsplatSequenceDecode.compute, lines 132-165.  Both normalise their quaternions of bytes.
"""
from __future__ import annotations

import io
import json
import struct
import zipfile

import mutations
import numpy as np
import pytest
from evaluated import assert_shows, directions, spherical
from PIL import Image

import fastgs_blender as fg
from fastgs_blender.model.from_frames import one_model

N, SIDE = 13, 4
START, DURATION, FPS = 2.0, 3.0, 20.0
TABLE = np.linspace(-2, 2, 256)
SIZES = np.linspace(-4, -1, 256)
LOW, HIGH = np.array([-1.0, -2, 0]), np.array([1.0, 1.5, 2])


def picture(pixels, kind="WEBP") -> bytes:
    out = io.BytesIO()
    padded = np.zeros((SIDE * SIDE, 4), np.uint8)
    padded[:len(pixels), :pixels.shape[1]] = pixels
    Image.fromarray(padded.reshape(SIDE, SIDE, 4)).save(out, kind, lossless=True, exact=True)
    return out.getvalue()


def zipped(files: dict[str, bytes]) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name), content)
    return out.getvalue()


def moving(rng, encoding="kmeans", kind="WEBP") -> tuple[dict[str, bytes], dict]:
    """One SOG4D in a folder, and its pixels."""
    p = {name: rng.integers(0, 256, (N, 4)) for name in ("means_l", "means_u", "scales", "sh0", "motion_l", "motion_u", "trbf", "trbf_u")}
    p["sh0"][0, 3], p["sh0"][1, 3] = 0, 255
    p["quats"] = np.concatenate([rng.integers(60, 196, (N, 3)), rng.integers(252, 256, (N, 1))], 1)
    trbf = {"encoding": "kmeans", "center_codebook": (START + np.linspace(0, DURATION, 256)).tolist(),
            "scale_codebook": np.linspace(-2, 2, 256).tolist(), "files": ["trbf.webp"]}
    if encoding == "quantize16":
        trbf = {"encoding": encoding, "center_min": 1.5, "center_max": 5.5, "scale_min": -2.0, "scale_max": 1.0,
                "files": ["trbf.webp", "trbf_u.webp"]}
    meta = {"version": 1, "type": "sog4d", "generator": "a test", "count": N, "width": SIDE, "height": SIDE, "sh_degree": 0, "start": START,
            "duration": DURATION, "fps": FPS,
            "means": {"mins": LOW.tolist(), "maxs": HIGH.tolist(), "files": ["means_l.webp", "means_u.webp"]},
            "quats": {"files": ["quats.webp"]}, "scales": {"codebook": SIZES.tolist(), "files": ["scales.webp"]},
            "sh0": {"codebook": TABLE.tolist(), "files": ["sh0.webp"]}, "trbf": trbf, "segments": [],
            "motion": {"mins": [-0.5] * 3, "maxs": [0.4] * 3, "files": ["motion_l.webp", "motion_u.webp"]}}
    return {"meta.json": json.dumps(meta).encode(), **{f"{name}.webp": picture(v, kind) for name, v in p.items()}}, p


def unlog(share, low, high):
    v = low + share * (high - low)
    return np.sign(v) * np.expm1(np.abs(v))


def static(p) -> dict:
    q = np.zeros((N, 4))
    for i, (*kept, tag) in enumerate(p["quats"]):
        kept = (2 * np.array(kept) / 255 - 1) / np.sqrt(2)
        q[i] = np.insert(kept, int(tag) - 252, np.sqrt(max(0, 1 - np.sum(kept**2))))
    position = unlog((p["means_l"] + 256 * p["means_u"])[:, :3] / 65535, LOW, HIGH)
    return {"position": position, "rotation": q, "opacity": p["sh0"][:, 3] / 255,
            "scale": np.exp(SIZES[p["scales"][:, :3]]), "colour": spherical(directions(N), TABLE[p["sh0"][:, :3]][:, None])}


def shown(p, time: float, encoding="kmeans") -> dict:
    """What SuperSplat 4D's shader draws at `time` in seconds."""
    if encoding == "kmeans":
        centre, width = START + DURATION * p["trbf"][:, 0] / 255, np.exp(-2 + 4 * p["trbf"][:, 1] / 255)
    else:
        share = (p["trbf"] + 256 * p["trbf_u"]) / 65535
        centre, width = 1.5 + 4 * share[:, 0], np.exp(-2 + 3 * share[:, 1])
    state, dt = static(p), time - centre
    opacity = state["opacity"] * np.exp(-(dt / width) ** 2)
    motion = unlog((p["motion_l"] + 256 * p["motion_u"])[:, :3] / 65535, -0.5, 0.4)
    return state | {"opacity": np.where(opacity < 0.005, 0, opacity), "position": state["position"] + motion * dt[:, None]}


@pytest.mark.parametrize(("encoding", "kind"), [("kmeans", "WEBP"), ("quantize16", "PNG")])
def test_supersplat_4d(tmp_path, rng, encoding, kind):
    files, p = moving(rng, encoding, kind)
    (tmp_path / "m.sog4d").write_bytes(zipped(files))
    model = fg.load(tmp_path / "m.sog4d")
    assert model.clip == fg.Clip(round(DURATION * FPS), FPS)
    for time in (1.9, START, 2.71, 3.5, START + DURATION):
        assert_shows(model, (time - START) / DURATION, **shown(p, time, encoding))


def test_supersplat_4d_with_static_parts(tmp_path, rng):
    inside, p = moving(rng)
    still, q = moving(rng)
    meta = {key: value for key, value in json.loads(still["meta.json"]).items() if key not in ("type", "motion", "trbf")}
    still["meta.json"] = json.dumps(meta | {"version": 2}).encode()
    main = {"type": "sog4d_multi", "version": 1, "dynamic": {"path": "dynamic/"}, "static": {"static_1": {"path": "static_1/"}}}
    (tmp_path / "m.sog4d").write_bytes(zipped({"meta.json": json.dumps(main).encode(), **{f"dynamic/{k}": v for k, v in inside.items()},
                                               **{f"static_1/{k}": v for k, v in still.items()}}))
    model = fg.load(tmp_path / "m.sog4d")
    for time in (START, 3.3):
        s = fg.slice_model(model, (time - START) / DURATION, cull=False)
        for name, moved in shown(p, time).items():
            if name in ("position", "opacity", "scale"):
                np.testing.assert_allclose(getattr(s, name), np.concatenate([static(q)[name], moved]), atol=1e-4)


@pytest.mark.parametrize("comment", ["comment cfg_args: start=2.0, duration=3.0, fps=20.0, sh_degree=1", ""])
def test_dynamic_ply(tmp_path, rng, comment):
    """The PLY from which SuperSplat 4D makes its .sog4d, here with SH 1: the law is the same."""
    names = [*"xyz", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4)), *(f"f_dc_{i}" for i in range(3)), "opacity",
             "trbf_center", "trbf_scale", *(f"motion_{i}" for i in range(3)), *(f"f_rest_{i}" for i in range(9))]
    v = rng.normal(0, 0.5, (N, len(names))).astype("<f4")
    v[:, 14] = rng.uniform(START, START + DURATION, N)
    v[0, 14] = START + DURATION
    columns = "".join(f"property float {name}\n" for name in names)
    comment = f"{comment}\n" if comment else ""
    head = f"ply\nformat binary_little_endian 1.0\n{comment}element vertex {N}\n{columns}end_header\n"
    (tmp_path / "m.ply").write_bytes(head.encode() + v.tobytes())
    model = fg.load(tmp_path / "m.ply")
    assert fg.formats.identify(tmp_path / "m.ply").name == "SuperSplat 4D PLY"
    start, length = (START, DURATION) if comment else (0.0, START + DURATION)
    assert model.clip.duration == pytest.approx(length)
    v = v.astype(np.float64)
    coefficients = np.concatenate([v[:, None, 10:13], v[:, 19:].reshape(N, 3, 3).transpose(0, 2, 1)], 1)
    for time in (2.1, 3.0, 4.4):
        dt = time - v[:, 14]
        opacity = np.exp(-(dt / np.exp(v[:, 15])) ** 2) / (1 + np.exp(-v[:, 13]))
        assert_shows(model, (time - start) / length, position=v[:, :3] + v[:, 16:19] * dt[:, None], rotation=v[:, 6:10],
                     scale=np.exp(v[:, 3:6]), opacity=np.where(opacity < 0.005, 0, opacity), colour=spherical(directions(N), coefficients))


def frames(rng, version=2, bands=3, count=3, times=None, delta=True) -> tuple[dict[str, bytes], list[dict]]:
    """A clip of gsplat-unity, and what each frame is."""
    files, told = {}, []
    bounds = rng.uniform(-2, -1, (count, 3)), rng.uniform(1, 2, (count, 3))
    sizes = np.exp(rng.uniform(-4, -1, (300, 3)))
    widths = [3, 5, 7][:bands] if version == 2 else [(bands + 1) ** 2 - 1] if bands else []
    palettes = [rng.normal(0, 0.3, (40, width, 3)).astype("<f2") for width in widths]
    keys = [f"sh{k + 1}" for k in range(bands)] if version == 2 else ["shN"][:bool(bands)]
    labels = {key: [rng.integers(0, 40, N)] for key in keys}
    for f in range(count):
        p = {name: rng.integers(0, 256, (N, 4)) for name in ("hi", "lo", "rotation", "sh0")}
        index = rng.integers(0, 300, N)
        p["scale"] = np.stack([index & 255, index >> 8], 1)
        for key in keys:
            if f and delta:
                changed = labels[key][-1].copy()
                changed[[2, 5]] = rng.integers(0, 40, 2)
                labels[key].append(changed)
            elif f:
                labels[key].append(rng.integers(0, 40, N))
            p[key] = labels[key][f][:, None]
        files |= {f"frames/{f:05}/{name}.webp": picture(pixels) for name, pixels in p.items()}
        q = (p["rotation"] - 128) / 128
        rest = [palette[labels[key][f]].astype(np.float64) for palette, key in zip(palettes, keys)]
        told.append({"position": bounds[0][f] + (bounds[1] - bounds[0])[f] * (p["lo"] + 256 * p["hi"])[:, :3] / 65535,
                     "rotation": q / np.linalg.norm(q, axis=1, keepdims=True), "scale": sizes[index], "opacity": p["sh0"][:, 3] / 255,
                     "coefficients": np.concatenate([TABLE[p["sh0"][:, :3]][:, None], *rest], 1)})
    streams = {}
    for key, palette in zip(keys, palettes):
        path = f"{key}_centroids.bin"
        files[path] = palette.tobytes()
        about = {"count": 40, "centroidsType": "f16", "centroidsPath": path}
        if delta:
            body = struct.pack("<8s5I", b"SOG4DLB1", 1, 0, count, N, 40)
            for before, after in zip(labels[key], labels[key][1:]):
                changed = np.flatnonzero(before != after)
                body += struct.pack("<I", len(changed)) + b"".join(struct.pack("<IHH", i, after[i], 0) for i in changed)
            files[f"sh/{key}.bin"] = body
            segment = {"startFrame": 0, "frameCount": count, "baseLabelsPath": f"frames/00000/{key}.webp", "deltaPath": f"sh/{key}.bin"}
            about |= {"labelsEncoding": "delta-v1", "deltaSegments": [segment]}
        else:
            about |= {"labelsEncoding": "full", "labelsPath": f"frames/{{frame}}/{key}.webp"}
        streams |= {key: about} if version == 2 else {f"shN{name[0].upper()}{name[1:]}": value for name, value in about.items()}

    def triples(rows):
        return [dict(zip("xyz", map(float, row))) for row in rows]

    meta = {"format": "sog4d", "version": version, "splatCount": N, "frameCount": count,
            "timeMapping": {"type": "explicit", "frameTimesNormalized": times} if times else {"type": "uniform"},
            "layout": {"type": "row-major", "width": SIDE, "height": SIDE}, "streams": {
                "position": {"rangeMin": triples(bounds[0]), "rangeMax": triples(bounds[1]), "hiPath": "frames/{frame}/hi.webp",
                             "loPath": "frames/{frame}/lo.webp"},
                "scale": {"codebook": triples(sizes), "indicesPath": "frames/{frame}/scale.webp"},
                "rotation": {"path": "frames/{frame}/rotation.webp"},
                "sh": {"bands": bands, "sh0Path": "frames/{frame}/sh0.webp", "sh0Codebook": TABLE.tolist(), **streams}}}
    return {"meta.json": json.dumps(meta).encode(), **files}, told


def between(a, b, share: float) -> dict:
    """gsplat-unity's interpolation."""
    turn = np.where(np.sum(a["rotation"] * b["rotation"], 1, keepdims=True) < 0, -1, 1) * b["rotation"]
    mixed = {key: a[key] + share * (b[key] - a[key]) for key in ("position", "opacity", "coefficients")}
    mixed |= {"scale": np.exp(np.log(a["scale"]) * (1 - share) + np.log(b["scale"]) * share),
              "rotation": a["rotation"] * (1 - share) + turn * share}
    return mixed | {"colour": spherical(directions(N), mixed.pop("coefficients"))}


@pytest.mark.parametrize(("version", "bands", "times", "delta"), [
    (2, 3, None, True), (2, 2, [0.0, 0.2, 1.0], False), (1, 1, None, False), (1, 3, [0.1, 0.1, 0.9], True), (1, 0, None, False)])
def test_frames_of_gsplat_unity(tmp_path, rng, version, bands, times, delta):
    files, told = frames(rng, version, bands, times=times, delta=delta)
    (tmp_path / "m.sog4d").write_bytes(zipped(files))
    source = fg.open_source(tmp_path / "m.sog4d")
    at = times or [0.0, 0.5, 1.0]
    for t in (0.0, 0.1, 0.15, 0.3, 0.5, 0.83, 0.95, 1.0):
        i = max((k for k, time in enumerate(at) if time <= t), default=0)
        j = min(i + 1, len(at) - 1)
        share = float(np.clip((t - at[i]) / (at[j] - at[i]), 0, 1)) if at[j] > at[i] else 0.0
        model, moment = source.moment(t)
        assert_shows(model, moment, **between(told[i], told[j], share))


def test_frames_become_one_model_wherever_they_lie(tmp_path, rng):
    """The format says that its Gaussians are the same ones; how far they jump from frame to frame does not matter."""
    files, _ = frames(rng, bands=0, count=4)
    (tmp_path / "m.sog4d").write_bytes(zipped(files))
    with pytest.warns(fg.LossWarning):
        assert len(one_model(fg.open_source(tmp_path / "m.sog4d"))) == N


@pytest.mark.parametrize(("change", "said"), [
    ({"version": 9}, "version 9"), ({"splatCount": 10**9}, "cannot hold"), ({"frameCount": 10**6}, "1000000 frames"),
    ({"layout": {"type": "row-major", "width": 2, "height": 2}}, "fewer Gaussians"), ({"streams": {}}, "meta.json.*position"),
    ({"timeMapping": {"type": "explicit", "frameTimesNormalized": [0, 2, 1]}}, "increase")])
def test_what_is_wrong_with_frames_has_a_name(tmp_path, rng, change, said):
    files, _ = frames(rng)
    files["meta.json"] = json.dumps(json.loads(files["meta.json"]) | change).encode()
    (tmp_path / "m.sog4d").write_bytes(zipped(files))
    with pytest.raises(fg.FastGSError, match=said):
        fg.open_source(tmp_path / "m.sog4d")


def test_frames_whose_pictures_lie_beside_the_file_are_told_to_be_packed(tmp_path, rng):
    (tmp_path / "m.sog4d").write_bytes(frames(rng)[0]["meta.json"])
    with pytest.raises(fg.FastGSError, match=r"m\.sog4d.*zip"):
        fg.open_source(tmp_path / "m.sog4d")


def test_mutated_files(tmp_path, rng):
    parts, _ = moving(rng)
    multi = {"meta.json": b'{"type": "sog4d_multi", "dynamic": {}}', **{f"dynamic/{k}": v for k, v in parts.items()}}
    seeds = {"one": parts, "16 bits": moving(rng, "quantize16")[0], "several": multi, "bands": frames(rng, 2, 2)[0],
             "palette": frames(rng, 1, 1, delta=False)[0]}
    seeds = {name: {"m.sog4d": zipped(files)} for name, files in seeds.items()}
    told = mutations.campaign("sog4d", mutations.shows("m.sog4d"), seeds, tmp_path)
    assert min(told.values(), default=1) > 0
