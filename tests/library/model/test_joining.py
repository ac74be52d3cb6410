# SPDX-License-Identifier: GPL-3.0-or-later
"""Segments joined into one model move, turn, fade and look exactly as they did."""
from dataclasses import replace

import numpy as np
import pytest
from random_cameras import random_camera
from random_models import APPEARANCES, random_model

import fastgs_blender as fg
from fastgs_blender.model.joining import Segment, join

SPANS = [(0.0, 0.5), (0.4, 0.5), (0.8, 0.5)]
"""Begin and length of three segments that overlap."""
BASES = {
    "static": fg.Static(), "paper": fg.Fourier(5), "mapped": fg.Fourier(3, scale=0.8, offset=0.1), "line": fg.Fourier(2, 1.0, 0.0, True),
    "cosine": fg.Cosine(6, 0.9, 0.05), "cubic": fg.Polynomial(3), "keys": fg.Keyframes((0.0, 0.3, 0.55, 1.0)),
}


def segments(rng, basis="paper", rotation="line", appearance="rgb", **options):
    first = random_model(rng, 20, BASES[basis], fg.Polynomial(1) if rotation == "line" else BASES[rotation], "radial", appearance)
    models = [random_model(rng, 20, first.basis, first.rotation_basis, "radial", first.appearance) for _ in SPANS]
    return [Segment(m, begin, length, **options) for m, (begin, length) in zip(models, SPANS)]


@pytest.mark.parametrize("rotation", ["line", "paper", "cosine", "static"])
@pytest.mark.parametrize("basis", BASES)
def test_each_segment_goes_on_as_it_did(rng, basis, rotation):
    parts = segments(rng, basis, rotation, appearance="sigmoid")
    joined = join(parts, fg.Clip(120, 30.0))
    for i, part in enumerate(parts):
        mine = joined.take(np.arange(20 * i, 20 * (i + 1)))
        for u in (0.02, 0.31, 0.77, 0.98):
            now, before = (fg.slice_model(m, t, cull=False) for m, t in ((mine, part.begin + part.length * u), (part.model, u)))
            np.testing.assert_allclose(now.position, before.position, atol=2e-5)
            np.testing.assert_allclose(np.abs((now.rotation * before.rotation).sum(1)), 1, atol=1e-5)
            np.testing.assert_allclose(now.velocity * part.length, before.velocity, atol=1e-3)
            np.testing.assert_allclose(now.opacity, before.opacity, atol=1e-5)
            np.testing.assert_allclose(now.features, before.features, atol=2e-5)


@pytest.mark.parametrize("appearance", [name for name in APPEARANCES if not name.startswith("changing")])
def test_between_flanks_the_picture_is_the_segments(rng, appearance):
    parts = segments(rng, appearance=appearance)
    shown = [(None, 0.45), (0.45, 0.85), (0.85, None)]
    joined = join([replace(part, shown=span, fade=1e-4) for part, span in zip(parts, shown)], fg.Clip(120, 30.0))
    camera = random_camera(rng, 40, 30, 3.0)
    for part, t in zip(parts, (0.2, 0.6, 1.0)):
        alone = fg.render(part.model, camera, (t - part.begin) / part.length, ("rgb", "alpha"))
        for name, image in fg.render(joined, camera, t, ("rgb", "alpha")).items():
            np.testing.assert_allclose(image, alone[name], atol=2e-4)


def test_joined_models_are_files_and_clips_like_any_other(rng, tmp_path):
    joined = join(segments(rng, "cosine", fade=0.02), fg.Clip(90, 25.0, 7))
    fg.save(joined, tmp_path / "long.safetensors")
    back = fg.load(tmp_path / "long.safetensors")
    assert back.clip == fg.Clip(90, 25.0, 7) and len(back) == 60 and back.basis == fg.Fourier(6, 0.9)
    assert all(np.array_equal(back.arrays[name], array) for name, array in joined.arrays.items())


def test_models_that_never_fade_stay_within_their_window(rng):
    parts = [replace(s, model=replace(s.model, temporal_kind=fg.Always(), temporal=None), shown=(s.begin, s.begin + s.length), fade=0.01)
             for s in segments(rng)]
    joined = join(parts, fg.Clip(10))
    opacity = fg.slice_model(joined, 0.2, cull=False).opacity
    np.testing.assert_allclose(opacity[:20], 1 / (1 + np.exp(-parts[0].model.opacity)), rtol=1e-5)
    assert opacity[40:].max() < 1e-6


@pytest.mark.parametrize(("change", "sentence"), [
    (lambda s: replace(s, length=0.4), "one length"),
    (lambda s: replace(s, model=replace(s.model, basis=fg.Fourier(5, 2.0))), "different bases"),
    (lambda s: replace(s, model=replace(s.model, axes="RUB")), "axes"),
    (lambda s: replace(s, model=replace(s.model, temporal_kind=fg.Window(), temporal=np.zeros((20, 4)))), "window"),
    (lambda s: replace(s, model=replace(s.model, appearance=fg.Features(), features=np.zeros((20, 9)))), "appearance"),
])
def test_what_does_not_fit_together_is_told(rng, change, sentence):
    parts = segments(rng)
    with pytest.raises(fg.FastGSError, match=sentence):
        join([parts[0], change(parts[1])], fg.Clip(10))


@pytest.mark.parametrize(("basis", "turn", "temporal", "appearance"), [
    ("paper", "line", "radial", "sh2"), ("cubic", "static", "window", "rgb"), ("keys", "line", "radial-window", "sh1"),
    ("static", "static", "always", "sigmoid")])
def test_models_put_together_look_as_they_did(rng, basis, turn, temporal, appearance):
    """Also beside one that stands still, is always there and has plainer colours; whatever the time."""
    first = random_model(rng, 9, basis, turn, temporal, appearance)
    look = first.appearance if appearance == "sigmoid" else "rgb" if appearance == "rgb" else "sh0"
    still = random_model(rng, 5, "static", "static", "always", look)
    if appearance == "sh2":
        still = replace(still, appearance=fg.RGB(), features=np.abs(still.features))
    for models in ([first, still], [still, first, still]):
        both = fg.concatenate(models)
        for t in (-0.2, 0.35, 1.1):
            now, parts = fg.slice_model(both, t, cull=False), [fg.slice_model(m, t, cull=False) for m in models]
            for name in ("position", "scale", "opacity"):
                np.testing.assert_allclose(getattr(now, name), np.concatenate([getattr(p, name) for p in parts]), atol=1e-6)
        camera = random_camera(rng)
        for i, m in enumerate(models):
            mine = both.take(slice(sum(map(len, models[:i])), sum(map(len, models[:i + 1]))))
            seen = [fg.render(each, camera, 0.4, backend="reference")["rgb"] for each in (mine, m)]
            np.testing.assert_allclose(*seen, atol=1e-5)


def test_models_of_other_kinds_are_not_put_together(rng):
    first = random_model(rng, 4, "paper", "line", "radial", "sh1")
    for other, said in ((random_model(rng, 4, "cubic", "line", "radial", "sh1"), "basis"), (replace(first, axes="RFU"), "axes"),
                        (random_model(rng, 4, "paper", "line", "window", "sh1"), "temporal"),
                        (replace(first, colour_space="linear"), "colour"),
                        (random_model(rng, 4, "paper", "line", "radial", "sigmoid"), "appearance")):
        with pytest.raises(fg.FastGSError, match=said):
            fg.concatenate([first, other])
    with pytest.raises(fg.FastGSError):
        fg.concatenate([])
    for given, said in ((first, "list.*GaussianModel"), ([first, 3], "list.*3"), ([first, "m.ply"], "list.*'m.ply'")):
        with pytest.raises(fg.FastGSError, match=said):
            fg.concatenate(given)


def test_large_arrays_lie_end_to_end(rng):
    """Opacities stay below the size from which an array gets pages of its own, places and motion do not."""
    models = [random_model(rng, n, "paper", "line", "radial", "sh1") for n in (15_000, 3, 1000)]
    both = fg.concatenate(models)
    for name, array in both.arrays.items():
        np.testing.assert_array_equal(array, np.concatenate([m.arrays[name] for m in models]))
