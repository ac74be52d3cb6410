# SPDX-License-Identifier: GPL-3.0-or-later
"""The player's modules compute what the library computes.  Node runs them here; pages in a browser draw with them (tests/blender)."""
import json
import shutil
import subprocess
from dataclasses import asdict, dataclass
from typing import ClassVar

import numpy as np
import pytest
from random_cameras import random_camera
from random_models import APPEARANCES, BASES, TEMPORALS, random_model

import fastgs_blender as fg
from fastgs_blender.formats.compressed import columns_of, packed_segment
from fastgs_blender.formats.description import describe
from fastgs_blender.formats.native import COMPRESSED, KEY, Native
from fastgs_blender.formats.native_arrays import DECODER
from fastgs_blender.formats.quantising import ATTRIBUTES, LIVES, SPREADS, Steps
from fastgs_blender.formats.web import library
from fastgs_blender.formats.web.page import Page, PageObject, player_files
from fastgs_blender.kernels.gl import model_texels
from fastgs_blender.kernels.gl.frame_table import frame_table
from fastgs_blender.model import appearance, motion
from fastgs_blender.model.basis import Basis
from fastgs_blender.model.temporal import KINDS as KINDS_OF_OPACITY
from fastgs_blender.rendering import visibility
from fastgs_blender.util.tensor_files import write_tensors

needs_node = pytest.mark.skipif(not shutil.which("node"), reason="node is not installed; pages in a browser hold the same")
KINDS = list(zip(BASES, [*BASES][::-1], [*TEMPORALS] * 2, APPEARANCES))
READ = """
import fs from "fs";
import {readModel} from "./model.js";
const model = await readModel(new Uint8Array(fs.readFileSync(process.argv[2])), () => {});
"""


@dataclass(frozen=True)
class Strange(Basis):
    """A basis that no page knows."""

    name: ClassVar[str] = "strange"
    terms: ClassVar[int] = 1

    def weights(self, t):
        return np.ones((*np.shape(t), 1))

    rates = weights


@pytest.fixture(scope="module")
def modules(tmp_path_factory):
    """A folder with the player's modules."""
    folder = tmp_path_factory.mktemp("player")
    for name, text in player_files().items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text, "utf-8")
    (folder / "package.json").write_text('{"type": "module"}')
    return folder


@pytest.fixture
def node(modules):
    """node(script, *arguments): what a script among the modules prints, as JSON."""
    def run(script, *arguments):
        (modules / "test.js").write_text(script)
        done = subprocess.run(["node", modules / "test.js", *map(str, arguments)], capture_output=True, text=True, timeout=300, check=False)
        assert not done.returncode, done.stderr
        return json.loads(done.stdout)
    return run


def write_compressed(rng, kinds, path, counts=(700, 300)):
    """A compressed file of a model's kinds with whole numbers and steps at random."""
    tensors, about = {}, {"count": list(counts), "steps": [], "blocks": []}
    for i, n in enumerate(counts):
        wide = {name: rng.choice([1.0, 4.0, 300.0], size=(n, 1)) for name in columns_of(kinds)}
        codes = {name: np.rint(rng.normal(0, wide[name], (n, int(np.prod(shape, dtype=int))))).astype(np.int64)
                 for name, shape in columns_of(kinds).items()}
        codes = {name: array.reshape(n, *columns_of(kinds)[name]) for name, array in codes.items()}
        codes |= {"scale": rng.integers(-3, 4, (n, 3)), "shape": rng.integers(-3, 4, n), "tint": rng.integers(-2, 3, n)}
        codes["life"] = rng.integers(0, 12, n)
        codes |= {name: rng.integers(0, 1 << 15, n) for name in codes if name.endswith((".high", ".low"))}
        table = rng.integers(-3, 4, (LIVES, kinds.basis.terms)), rng.integers(-3, 4, (LIVES, kinds.rotation_basis.terms))
        steps = Steps({name: float(rng.uniform(0.001, 0.1)) for name in ATTRIBUTES}, rng.uniform(0.01, 0.1, kinds.appearance.width),
                      rng.integers(-2, 3, SPREADS), *table, ["scale/0", "scale/2", "opacity/0", "features/1", "temporal.0/0"],
                      [(0, 1)], -20)
        data, blocks = packed_segment(codes, steps, kinds)
        tensors[f"segment.{i}"] = np.frombuffer(data, np.uint8)
        about["blocks"].append(blocks)
        about["steps"].append({key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in asdict(steps).items()})
    if isinstance(kinds.appearance, fg.Features):
        tensors |= {f"decoder.{key}": getattr(kinds.appearance, key) for key in DECODER}
    write_tensors(path, tensors, {KEY: json.dumps({"version": COMPRESSED, "model": describe(kinds), "compressed": about})})
    return path


@pytest.mark.slow
@needs_node
@pytest.mark.parametrize("kinds", KINDS, ids="-".join)
def test_a_model_is_read_to_the_last_bit(node, rng, tmp_path, kinds):
    basis, turns, temporal, look = kinds
    model = random_model(rng, 30, basis, turns, temporal, look)
    fg.save(model, tmp_path / "exact.safetensors")
    for path in (write_compressed(rng, model, tmp_path / "small.safetensors"), tmp_path / "exact.safetensors"):
        want = Native().load(path)
        got = node(READ + """
            const numbers = Object.entries(model.arrays).map(([name, array]) => [name, Array.from(array)]);
            console.log(JSON.stringify(Object.fromEntries(numbers)));""", path)
        assert len(want)
        for name, array in want.arrays.items():
            np.testing.assert_array_equal(np.array(got[name], np.float32).reshape(array.shape), array, err_msg=name)


@pytest.mark.slow
@needs_node
@pytest.mark.parametrize("kinds", KINDS, ids="-".join)
def test_tables_texels_and_orders_are_those_of_viewports(node, rng, tmp_path, kinds):
    basis, turns, temporal, look = kinds
    model = random_model(rng, 500, basis, turns, temporal, look)
    fg.save(model, tmp_path / "exact.safetensors")
    box = fg.Crop(np.diag([1.2, 1.1, 1.3, 1.0]), soft=0.4)
    settings = fg.ObjectSettings(crops=(fg.Crop(np.diag([3.0, 3, 3, 1]), remove=True, shape="SPHERE"), box), exposure=0.4, opacity=0.8,
                                 splat_scale=1.2, pixel_size=0.004)
    place = np.array([[0.8, 0.1, 0, 0.2], [0, 1.1, 0.2, 0], [0.1, 0, 1.3, -0.1], [0, 0, 0, 1.0]])
    camera = random_camera(rng, 64, 48, 4.0)
    page = Page([PageObject(model, (place,), (), (settings,)), PageObject(model)], [camera], frames=40)
    description = page.description()
    frame = 13
    instances = [instance.viewed(camera) for instance in page.instances(frame)]
    layout = model_texels.layout_of(model)
    texels = model_texels.Place(8192 * 3 + 5, 8192 + 7, layout)
    want = frame_table(camera, instances, lambda model: texels, 321, {0: 0, 1: 1}, None)
    got = node(READ + """
        import {layoutOf, rowsOf} from "./texels.js";
        import {Sorter, prepared} from "./order.js";
        import {Scene} from "./scene.js";
        import {frameTable, grouped} from "./tables.js";
        import {inverse} from "./matrices.js";
        import {spreads, viewed} from "./views.js";
        const given = JSON.parse(fs.readFileSync(process.argv[3])), scene = new Scene(given.description), {camera} = given;
        scene.models = [model];
        const views = scene.at(given.frame).map((each) => viewed(each, model.kinds, camera, inverse(camera.pose)));
        const places = [{geometry: given.places[0], colour: given.places[1], layout: layoutOf(model.kinds)}];
        const table = frameTable(camera, views, places, 321, [0, 1], 8192);
        const texels = Object.fromEntries(["geometry", "colour"].map((kind) =>
            [kind, [...rowsOf(model, kind, 64, 3)].flatMap(({texels}) => [...texels])]));
        const asked = {instances: views, camera: {...camera, spread: spreads(camera), around: 0}, width: 64, volumes: []};
        const {count, list, channels} = new Sorter().order(asked, [{...model, ...prepared(model)}]);
        console.log(JSON.stringify({table: [...table.data], rows: table.height, texels, channels, order: [...list.slice(0, 2 * count)],
                                    groups: grouped(views).groups.length}));
        """, tmp_path / "exact.safetensors", _given(tmp_path, description, camera, frame, [8192 * 3 + 5, 8192 + 7]))
    table = np.array(got["table"], np.float32).reshape(got["rows"], -1, 4)
    np.testing.assert_allclose(table[:, :want.shape[1]], want, rtol=2e-6, atol=2e-6)
    for kind, write in (("geometry", model_texels.write_geometry), ("colour", model_texels.write_colour)):
        out = np.zeros((len(model), getattr(layout, kind), 4), np.float32)
        write(model, out)
        np.testing.assert_allclose(np.array(got["texels"][kind], np.float32)[:out.size], out.ravel(), rtol=1e-6, atol=1e-6)
    order = visibility.order(instances, camera)
    share = visibility.crop_shares(instances, order)
    found = np.array(got["order"]).reshape(-1, 2)
    assert got["channels"] == 2 and len(order) > 50
    np.testing.assert_array_equal(found[:, 0], order)
    np.testing.assert_allclose(found[:, 1], 1 - share, atol=1e-5)
    assert got["groups"] == (2 if isinstance(model.appearance, fg.Features) else 1)


def _given(folder, description, camera, frame, places):
    """The path of a file with what the script is to know."""
    seen = {**description["opening"]["cameras"][0], "near": float(camera.near)}
    path = folder / "given.json"
    path.write_text(json.dumps({"description": description, "camera": seen, "frame": frame, "places": places}))
    return path


@needs_node
def test_a_damaged_model_ends_in_a_sentence(node, rng, tmp_path):
    """Whatever is changed in the file: it plays, or says so; memory stays within what the browser gives."""
    path = write_compressed(rng, random_model(rng, 4, "paper", "line", "window", "clamp"), tmp_path / "small.safetensors", (90, 40))
    got = node("""
        import fs from "fs";
        import {readModel} from "./model.js";
        import {PageError, sentence} from "./errors.js";
        const bytes = new Uint8Array(fs.readFileSync(process.argv[2])), said = [], length = bytes.length, wrong = [];
        const header = 8 + bytes[0] + 256 * bytes[1];
        let state = 1;
        const random = (n) => (state = (Math.imul(state, 1664525) + 1013904223) >>> 0) % n;
        for (let k = 0; k < 600; k++) {
            let copy = bytes.slice(0, k % 7 ? length : random(length));
            const within = k % 2 ? Math.min(header, copy.length) : copy.length;
            for (let j = 0; j < 1 + k % 3; j++) copy[random(within)] = k % 5 ? random(256) : 57;
            try {
                await readModel(copy, () => {});
                said.push("");
            } catch (error) {
                if (!(error instanceof PageError || error instanceof RangeError)) wrong.push(String(error.stack));
                said.push(sentence(error));
            }
        }
        console.log(JSON.stringify({said: [...new Set(said)], count: said.filter(Boolean).length, wrong: [...new Set(wrong)]}));
        """, path)
    assert not got["wrong"]
    assert got["count"] > 300 and len(got["said"]) > 10
    assert all(text == "" or text.endswith(".") for text in got["said"])


@needs_node
def test_between_frames_places_turn_and_times_go_on(node):
    """Half-way between two places, and times that jump where a loop begins anew."""
    turn = np.deg2rad(80)
    before, after = np.eye(4), np.diag([2.0, 2, 2, 1])
    after[:2, :2] = 2 * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    after[:3, 3] = 4, 0, 2
    got = node("""
        import {between, inverse, stretch} from "./matrices.js";
        import {time} from "./scene.js";
        const [a, b] = JSON.parse(process.argv[2]), times = [0.5, 0.7, 0.9, 0.1, 0.3, 0.5];
        console.log(JSON.stringify({middle: [...between(a, b, 0.5)], inverse: [...inverse(b)], stretch: stretch(b),
                                    times: [1.5, 2.5, 3.5, 9].map((frame) => time(times, frame, 6)), free: time([], 3.3, 6)}));
        """, json.dumps([before.ravel().tolist(), after.ravel().tolist()]))
    half = turn / 2
    want = np.eye(4)
    want[:3, :3] = 1.5 * np.array([[np.cos(half), -np.sin(half), 0], [np.sin(half), np.cos(half), 0], [0, 0, 1]])
    want[:3, 3] = 2, 0, 1
    np.testing.assert_allclose(np.reshape(got["middle"], (4, 4)), want, atol=1e-12)
    np.testing.assert_allclose(np.reshape(got["inverse"], (4, 4)), np.linalg.inv(after), atol=1e-12)
    assert got["stretch"] == pytest.approx(2)
    np.testing.assert_allclose(got["times"], [0.8, 1.0, 0.2, 0.5], atol=1e-12)
    assert got["free"] == pytest.approx(0.55)


@pytest.mark.slow
def test_what_a_page_cannot_play_is_said(rng):
    model = random_model(rng, 20)
    assert library.cannot_play(model) is None
    assert library.cannot_play(random_model(rng, 5, "smooth keys", "line", "window", "changing sh1")) is None
    assert set(library.BASES) == set(motion.BASES) and set(library.TEMPORALS) == set(KINDS_OF_OPACITY)
    assert set(library.LOOKS) == set(appearance.APPEARANCES)
    assert "'strange'" in library.cannot_play(random_model(rng, 5, Strange()))
    long = random_model(rng, 300, fg.Keyframes(tuple(np.linspace(0, 1, 90_000))))
    assert "248 Gaussians" in library.cannot_play(long) and "300" in library.cannot_play(long)
