# SPDX-License-Identifier: GPL-3.0-or-later
"""The add-on inside the bpy wheel, loaded as Blender loads it: bl_ext.user_default.fastgs_blender."""
from __future__ import annotations

import os
import shutil
import tempfile
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import image_files
import numpy as np
import pytest
import windows_rules
from hypothesis import HealthCheck, settings

settings.register_profile("fastgs", deadline=None, derandomize=True, database=None, suppress_health_check=[
    HealthCheck.too_slow, HealthCheck.function_scoped_fixture])  # how fast the machine is does not matter
settings.load_profile("fastgs")

windows_rules.install()
ROOT = Path(__file__).resolve().parents[2]
ADDON = "bl_ext.user_default.fastgs_blender"

FIRST = ("test_frusta.py",)
"""Files that begin: Blender 5.2 as a module crashes in Image.gl_load, because its shader for smaller copies of an image was freed, if
certain other files ran before in the same process, test_viewport.py for one."""
SLOWEST = ("test_maintenance.py", "test_training_jobs.py", "test_docs_python.py", "test_example_script.py", "test_viewport_pictures.py",
           "test_export_splats.py", "test_engine_passes.py", "test_batch.py", "test_stitch.py", "test_capture_scene.py",
           "test_export_page.py", "test_bake_operator.py", "test_moving_mesh.py")
"""Files that take longest.  They begin first, so that no worker is left alone with one at the end; the first compiles for all."""

USER = tempfile.TemporaryDirectory(prefix="fastgs-blender-")
os.environ["BLENDER_USER_RESOURCES"] = USER.name  # before the first test module imports bpy, which reads it once
os.environ.setdefault("FASTGS_CACHE_DIR", str(ROOT / "build" / "cache"))  # all processes, and the library's tests, share compiled kernels
os.environ["FASTGS_DEVICE"] = "cpu"  # training looks for no GPU, which takes a third of a short run's time, unless a test asks for one


def pytest_collection_modifyitems(items):
    order = FIRST + SLOWEST
    items.sort(key=lambda item: order.index(item.path.name) if item.path.name in order else len(order))


@pytest.fixture(scope="session")
def addon():
    """The enabled extension's root module.  Blender's user folder is a temporary one, in which the repository is linked.

    Windows, where links are for administrators, gets a copy.
    """
    pytest.importorskip("bpy")
    import addon_utils

    folder = Path(USER.name) / "extensions" / "user_default"
    folder.mkdir(parents=True)
    if os.name == "nt":
        shutil.copytree(ROOT, folder / "fastgs_blender", ignore=shutil.ignore_patterns(".*", "tests", "build", "dist", "benchmarks"))
    else:
        (folder / "fastgs_blender").symlink_to(ROOT, target_is_directory=True)
    module = addon_utils.enable(ADDON, default_set=True)
    assert module is not None, "the extension could not be enabled; the reason stands above"
    yield module
    addon_utils.disable(ADDON, default_set=True)


@pytest.fixture(scope="session")
def module(addon):
    """module("scene.time") imports a module of the extension."""
    return lambda name: import_module(f"{ADDON}.{name}")


@pytest.fixture(scope="session")
def fg(module):
    """The library as the extension sees it."""
    return module("fastgs_blender")


@pytest.fixture(autouse=True)
def scene(addon):
    """Every test begins with an empty scene, rendered by FASTGS at 64 x 48 under the view transform Standard."""
    import bpy

    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.render.engine = 'FASTGS'
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 64, 48, 100
    scene.view_settings.view_transform = 'Standard'
    scene.render.dither_intensity = 0
    return scene


@pytest.fixture
def make_model(fg):
    """make_model(n=40, seed=0, spread=1.0, **fields): a random cloud around the origin, small enough for the reference."""

    def make(n=40, seed=0, spread=1.0, **fields):
        rng = np.random.default_rng(seed)
        defaults = dict(
            position=rng.uniform(-spread, spread, (n, 3)),
            rotation=rng.normal(size=(n, 4)),
            scale=np.log(rng.uniform(0.05, 0.3, (n, 3)) * spread),
            opacity=rng.uniform(-2, 4, n),
            features=rng.uniform(0, 1, (n, 3)),
        )
        return fg.GaussianModel(**(defaults | fields))

    return make


@pytest.fixture
def model_file(fg, tmp_path):
    """model_file(model, name="model.safetensors"): its path, as written."""

    def write(model, name="model.safetensors"):
        path = tmp_path / name
        fg.save(model, path)
        return str(path)

    return write


@pytest.fixture
def splat_object(scene, module):
    """splat_object(path, name="Splats", matrix=None, collection=None): an object that shows a file, without an importer."""
    import bpy
    from mathutils import Matrix

    def make(path, name="Splats", matrix=None, collection=None):
        obj = bpy.data.objects.new(name, bpy.data.meshes.new(name))
        module("scene.paths").put(obj.fastgs, str(path))
        if matrix is not None:
            obj.matrix_world = Matrix(np.asarray(matrix, float).tolist())
        (collection or scene.collection).objects.link(obj)
        return obj

    return make


@pytest.fixture
def add_camera(scene):
    """add_camera(location=(0, -5, 0), rotation=(90, 0, 0), **data): the scene's camera; rotation in degrees."""
    import bpy

    def add(location=(0, -5, 0), rotation=(90, 0, 0), **data):
        camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
        camera.location, camera.rotation_euler = location, np.radians(rotation)
        for name, value in data.items():
            setattr(camera.data, name, value)
        scene.collection.objects.link(camera)
        scene.camera = camera
        return camera

    return add


@pytest.fixture
def render(scene, tmp_path):
    """render(kind="EXR"): render the scene and read the file back, the top row first.

    "EXR"    dict of "Layer.Pass" (or "Combined" ...) -> float32 [h, w, channels]
    "PNG"    uint8 [h, w, 4], "PNG16" uint16, as a viewer shows it
    """
    import bpy

    def run(kind="EXR", **options):
        path = tmp_path / f"render.{'exr' if kind == 'EXR' else 'png'}"
        image_files.set_output(scene, kind)
        scene.render.filepath = str(path)
        bpy.ops.render.render(write_still=True, **options)
        return image_files.read_exr(path) if kind == "EXR" else image_files.read_png(path)

    return run


@pytest.fixture
def compositor(scene):
    """The scene's compositor: .layers is a Render Layers node, .show(name) links one of its sockets to the output."""
    import bpy

    scene.view_settings.view_transform = 'Raw'
    if bpy.app.version >= (5, 0, 0):
        tree = scene.compositing_node_group = bpy.data.node_groups.new("Compositor", 'CompositorNodeTree')
        tree.interface.new_socket(name="Image", in_out='OUTPUT', socket_type='NodeSocketColor')
        output = tree.nodes.new('NodeGroupOutput')
    else:
        scene.use_nodes = True
        tree = scene.node_tree
        tree.nodes.clear()
        output = tree.nodes.new('CompositorNodeComposite')
    layers = tree.nodes.new('CompositorNodeRLayers')
    layers.scene = scene
    return SimpleNamespace(layers=layers, show=lambda name: tree.links.new(layers.outputs[name], output.inputs[0]))


@pytest.fixture
def target(tmp_path):
    """Where bake() writes its model."""
    return str(tmp_path / "baked.safetensors")


@pytest.fixture
def bake(scene, fg, target):
    """bake(*objects, **options) -> the model: select the objects, run the operator on frames 1 to 12, read its file."""
    import bpy

    scene.frame_start, scene.frame_end = 1, 12

    def run(*objects, **options):
        for obj in scene.objects:
            obj.select_set(obj in objects)
        bpy.ops.fastgs.bake(**{"filepath": target, "count": 400, **options})
        return fg.load(target)

    return run


@pytest.fixture
def add(scene):
    """add("primitive", **options): one of Blender's mesh primitives."""
    import bpy

    def make(kind, **options):
        getattr(bpy.ops.mesh, f"primitive_{kind}_add")(**options)
        return bpy.context.object

    return make


@pytest.fixture
def paint():
    """paint(obj, colour, name="Paint"): a new material on an object, in scene-linear colour; returns it and its shader node."""
    import bpy

    def make(obj, colour=(0.8, 0.8, 0.8), name="Paint"):
        material = bpy.data.materials.new(name)
        if bpy.app.version < (5, 0, 0):
            material.use_nodes = True
        shader = material.node_tree.nodes["Principled BSDF"]
        shader.inputs["Base Color"].default_value = (*colour, 1)
        obj.data.materials.append(material)
        return material, shader

    return make


@pytest.fixture
def cameras(module):
    return module("scene.camera")


@pytest.fixture
def now(scene, cameras):
    """now(object): the library's camera of a Blender camera on the current frame, as the engine reads it."""
    import bpy

    def read(obj):
        depsgraph = bpy.context.evaluated_depsgraph_get()
        return cameras.camera_of(obj.evaluated_get(depsgraph), cameras.render_area(scene.render), depsgraph)

    return read


@pytest.fixture
def splats(scene, make_model, model_file):
    """A splat object, turned, moved and stretched, alone selected."""
    import bpy
    import ordinary

    bpy.ops.import_scene.fastgs(filepath=model_file(make_model(200, seed=2)))
    obj = bpy.context.object
    obj.matrix_world = ordinary.POSE
    bpy.context.view_layer.update()
    return obj


@pytest.fixture
def where(module):
    """where(): the placement of each splat that is rendered, by name."""
    import bpy

    take = module("scene.snapshot").take

    def read():
        return {item.name: item.placement for item in take(bpy.context.evaluated_depsgraph_get()).instances}

    return read


@pytest.fixture
def told(module, monkeypatch):
    """The sentences that users are told."""
    found = []
    monkeypatch.setattr(module("scene.notices"), "tell", found.append)
    return found


@pytest.fixture
def screen(fg, model_file, splat_object):
    """A screen of opaque red Gaussians at y = 0, which a camera at y = -5 sees everywhere; its object."""
    x, z = (a.ravel() for a in np.meshgrid(np.linspace(-3, 3, 70), np.linspace(-3, 3, 70)))
    n = len(x)
    model = fg.GaussianModel(position=np.stack([x, np.zeros(n), z], 1), rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
                             scale=np.full((n, 3), -2.4), opacity=np.full(n, 6.0), features=np.tile((0.9, 0.1, 0.1), (n, 1)))
    return splat_object(model_file(model))


@pytest.fixture
def shine(scene):
    """shine(obj, colour, alpha=1): the object's surface sends out light of this colour, whatever the lamps, and lets the rest through."""
    import bpy

    def make(obj, colour, alpha=1.0):
        material = bpy.data.materials.new("Shine")
        if bpy.app.version < (5, 0, 0):
            material.use_nodes = True
        tree = material.node_tree
        emission, mix = tree.nodes.new('ShaderNodeEmission'), tree.nodes.new('ShaderNodeMixShader')
        emission.inputs["Color"].default_value, mix.inputs["Fac"].default_value = (*colour, 1), alpha
        surface = emission.outputs[0]
        if alpha < 1:
            tree.links.new(tree.nodes.new('ShaderNodeBsdfTransparent').outputs[0], mix.inputs[1])
            tree.links.new(surface, mix.inputs[2])
            surface = mix.outputs[0]
        tree.links.new(surface, tree.get_output_node('ALL').inputs["Surface"])
        obj.data.materials.append(material)
        return obj

    return make


@pytest.fixture
def wall(add, shine):
    """wall(x, y, colour, size=1.6, **options): a shining square across the view, before the screen of splats where y is negative."""
    return lambda x, y, colour, size=1.6, **options: shine(
        add("plane", size=size, location=(x, y, 0), rotation=(np.pi / 2, 0, 0)), colour, **options)


@pytest.fixture
def sky(scene):
    """A world of one colour."""
    import bpy

    world = scene.world = bpy.data.worlds.new("World")
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.2, 0.3, 0.4, 1)


@pytest.fixture
def choose(scene, module):
    """choose(engine='CYCLES', of=scene): what the panel's menu does; returns the scene of the meshes, with few samples."""
    def run(engine='CYCLES', of=scene):
        of.fastgs.render_meshes = engine
        other = module("scene.mesh_scene").of(of)
        other.cycles.samples, other.cycles.use_denoising = 4, False
        return other

    scene.view_settings.view_transform = 'Raw'
    return run


@pytest.fixture
def warned(caplog):
    """warned(): the sentences that the last render has told."""
    def texts():
        found = [record.message for record in caplog.records if record.levelname == "WARNING"]
        caplog.clear()
        return found

    return texts
