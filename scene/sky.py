# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders worlds that are more than one colour, as the background of splats.

Only Blender itself knows what all its nodes look like.  So a Blender of its own, without a window, renders the world once as a
panorama; the panorama is kept until something in the world changes, and pictures look it up in their own directions.
"""
from __future__ import annotations

import hashlib
import logging
import math
import os
import subprocess
import sys
import tempfile
import threading
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from .. import fastgs_blender as fg
from ..fastgs_blender.util.processes import hidden

log = logging.getLogger(__name__)

WIDTHS = 1024, 16384
"""Least and largest width of a panorama in pixels; between them it is that of the world's images."""
STRIP = 2048
"""Rows that are rendered at a time: the other Blender's memory stays bounded."""
PLAIN_WIDTH = 2048
"""Width of the panorama of a world without images, such as a sky."""
KEPT = 2
MOST_BYTES = 1 << 30
"""Of all panoramas that are kept, beside the newest."""
PATIENCE = 600
"""Seconds that a Blender may take for a world; by then it hangs."""

_CHILD = """
import sys
import bpy
import numpy as np
file, name, target, width, strip, frame, subframe, space, light = sys.argv[sys.argv.index("--") + 1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
if space:
    bpy.ops.wm.set_working_color_space(working_space=space, convert_colors=False)
with bpy.data.libraries.load(file) as (there, here):
    here.worlds = [name]
scene = bpy.context.scene
world = scene.world = here.worlds[0]
if light:  # what lamps of the world see is not what the camera sees
    for tree in [world.node_tree, *bpy.data.node_groups]:
        for node in [node for node in tree.nodes if node.bl_idname == 'ShaderNodeLightPath']:
            for link in [link for socket in node.outputs for link in socket.links]:
                value = tree.nodes.new('ShaderNodeValue').outputs[0]
                value.default_value = float(link.from_socket.name in ("Is Diffuse Ray", "Ray Depth", "Diffuse Depth"))
                tree.links.new(value, link.to_socket)
scene.frame_set(int(frame), subframe=float(subframe))
camera = scene.camera = bpy.data.objects.new("Eye", bpy.data.cameras.new("Eye"))
scene.collection.objects.link(camera)
camera.rotation_euler.x = np.pi / 2
scene.render.engine = 'CYCLES'
camera.data.type = 'PANO'
(camera.data if hasattr(camera.data, "panorama_type") else camera.data.cycles).panorama_type = 'EQUIRECTANGULAR'
world.cycles.sampling_method = 'NONE'
cycles = scene.cycles
cycles.samples, cycles.use_denoising, cycles.use_adaptive_sampling = 1, False, False
cycles.pixel_filter_type, cycles.filter_width = 'GAUSSIAN', 0.01  # the pixels' centres, without noise
render = scene.render
width, height, strip = int(width), int(width) // 2, int(strip)
render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100
render.use_border = render.use_crop_to_border = True
render.film_transparent = False
if hasattr(render.image_settings, "media_type"):
    render.image_settings.media_type = 'IMAGE'
render.image_settings.file_format, render.image_settings.color_depth, render.image_settings.color_mode = 'OPEN_EXR', '32', 'RGB'
render.image_settings.exr_codec = 'NONE'
render.filepath = target + ".exr"
values = np.lib.format.open_memmap(target + ".npy", "w+", np.float32, (height, width, 3))
for low in range(0, height, strip):
    high = min(low + strip, height)
    render.border_min_y, render.border_max_y = low / height, high / height
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(render.filepath)
    image.colorspace_settings.name = 'Non-Color'
    rows = np.empty((high - low, width, 4), np.float32)
    image.pixels.foreach_get(rows.ravel())
    values[low:high] = rows[..., :3]
    bpy.data.images.remove(image)
values.flush()
"""


@dataclass(frozen=True, eq=False)
class Panorama:
    """A world in every direction: values [h, 2 h, 3] float32, scene-linear; the lowest row first, +Y in the middle of a row."""

    values: np.ndarray

    def towards(self, directions: np.ndarray) -> np.ndarray:
        """Colours [..., 3] float32 in unit directions [..., 3] of the world, interpolated between the panorama's pixels."""
        height, width = self.values.shape[:2]
        x, y, z = np.moveaxis(np.asarray(directions, np.float64), -1, 0)
        u = (np.arctan2(x, y) / (2 * np.pi) + 0.5) * width - 0.5
        v = np.clip((np.arcsin(np.clip(z, -1, 1)) / np.pi + 0.5) * height - 0.5, 0, height - 1)
        left, low = np.floor(u).astype(np.int64), np.minimum(np.floor(v).astype(np.int64), height - 2)
        across, up = (u - left).astype(np.float32)[..., None], (v - low).astype(np.float32)[..., None]
        columns = left % width, (left + 1) % width
        rows = [self.values[low + i, columns[0]] * (1 - across) + self.values[low + i, columns[1]] * across for i in (0, 1)]
        return rows[0] * (1 - up) + rows[1] * up

    def reduced(self, width: int) -> np.ndarray:
        """Its values, of every so many pixels the mean, so that they are at most so wide."""
        values = self.values
        while values.shape[1] > width:
            values = values.reshape(len(values) // 2, 2, values.shape[1] // 2, 2, 3).mean((1, 3))
        return values

    def behind(self, camera: fg.Camera) -> np.ndarray:
        """The part of the panorama that a camera sees: [h, w, 3] float32 of the camera's window."""
        return self.towards(camera.rays(camera.world_to_camera)[1])


class Sky:
    """Panoramas of the worlds that were asked for last, and the Blender that makes the next one."""

    def __init__(self):
        self._lock = threading.Lock()
        self._found: dict[str, Panorama | str] = {}
        self._thread: threading.Thread | None = None
        self._making: str | None = None
        self._process: subprocess.Popen | None = None

    @property
    def busy(self) -> bool:
        """Whether a panorama is being made."""
        return self._thread is not None and self._thread.is_alive()

    def get(self, request: WorldRequest) -> Panorama | str | None:
        """The panorama, or a sentence that says why there is none; None where it is not known yet."""
        with self._lock:
            return self._found.get(request.key)

    def ask(self, request: WorldRequest) -> None:
        """Begin to make the panorama, unless it is there or another one is being made."""
        if self.get(request) is not None or self.busy:
            return
        folder = tempfile.TemporaryDirectory(prefix="fastgs-world-")
        request.write(Path(folder.name) / "world.blend")
        self._making = request.key
        self._thread = threading.Thread(target=self._make, args=(request, folder), name="fastgs-world", daemon=True)
        self._thread.start()

    def wait(self, seconds: float) -> None:
        """Wait for the panorama that is being made, at most so long."""
        if self._thread is not None:
            self._thread.join(seconds)

    def made(self, request: WorldRequest) -> Panorama | None:
        """The panorama, which is made and waited for; None where that fails."""
        while (found := self.get(request)) is None:
            self.ask(request)
            self.wait(PATIENCE)
        return found if isinstance(found, Panorama) else None

    def latest(self) -> Panorama | None:
        """The panorama that was made last; viewports show it until a newer one is ready."""
        with self._lock:
            return next((found for found in reversed(self._found.values()) if isinstance(found, Panorama)), None)

    def stop(self) -> None:
        """End the other Blender, and forget everything."""
        if self._process is not None and self._process.poll() is None:
            self._process.terminate()
        self.wait(10)
        with self._lock:
            self._found.clear()

    def _make(self, request, folder):
        with folder:
            try:
                found = Panorama(self._rendered(request, Path(folder.name)))
            except (OSError, ValueError, subprocess.SubprocessError) as error:
                log.warning("the world: %s", error)
                found = f'The world "{request.name}" could not be rendered: its plain colour is shown, and the log holds the reason.'
        with self._lock:
            self._found[request.key] = found
            while len(self._found) > KEPT or (len(self._found) > 1 and self._nbytes > MOST_BYTES):
                del self._found[next(iter(self._found))]

    @property
    def _nbytes(self) -> int:
        return sum(found.values.nbytes for found in self._found.values() if isinstance(found, Panorama))

    def _rendered(self, request, folder) -> np.ndarray:
        script, target = folder / "panorama.py", folder / "panorama"
        script.write_text(_CHILD, "utf-8")
        given = ["--", folder / "world.blend", request.name, target, str(request.width), str(STRIP), *(str(v) for v in request.frame),
                 request.space, "light" * request.light]
        blender = [bpy.app.binary_path, "-b", "--factory-startup", "-noaudio", "--python-exit-code", "1", "-P"]
        # A Blender without extensions takes their wheels away from the folder of its user: it has a user of its own.
        (folder / "user").mkdir()
        user = os.environ | {"BLENDER_USER_RESOURCES": str(folder / "user")}
        self._process = subprocess.Popen([*(blender if bpy.app.binary_path else [sys.executable]), script, *given],
                                         stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=user, **hidden())
        said, _ = self._process.communicate(timeout=PATIENCE)
        if self._process.returncode or not target.with_suffix(".npy").exists():
            raise OSError("\n".join(said.decode(errors="replace").strip().splitlines()[-8:]) or "no reason given")
        return np.load(target.with_suffix(".npy"))


sky = Sky()


@dataclass(frozen=True, eq=False)
class WorldRequest:
    """A world on one frame, with all that its panorama depends on.

    light  whether it is to be as it lights, and not as cameras see it; the same where no Light Path node of it tells these apart
    """

    world: bpy.types.World
    frame: tuple[int, float]
    light: bool = False

    def __post_init__(self):
        nodes = list(_nodes(self.world.node_tree))
        images = [node.image for node in nodes if getattr(node, "image", None) is not None]
        widest = max((image.size[0] for image in images), default=PLAIN_WIDTH)
        set_ = object.__setattr__
        set_(self, "name", self.world.original.name)
        set_(self, "width", 2 ** math.ceil(math.log2(min(max(widest, WIDTHS[0]), WIDTHS[1]))))
        set_(self, "space", bpy.data.colorspace.working_space if hasattr(bpy.data, "colorspace") else "")
        set_(self, "light", self.light and any(node.bl_idname == 'ShaderNodeLightPath' for node in nodes))
        known = [self.name, self.space, self.width, self.light, _edits, *facts(self.world)]
        set_(self, "key", hashlib.sha256(repr(known).encode()).hexdigest())

    def write(self, path: Path) -> None:
        """Write the world, with all that it needs, to a .blend."""
        bpy.data.libraries.write(str(path), {self.world.original}, path_remap='ABSOLUTE', fake_user=True)


_edits = 0


def edited(scene=None, depsgraph=None) -> None:
    """A handler: the pixels of an image may be others now, which no property of the world tells."""
    global _edits
    if depsgraph is not None and depsgraph.id_type_updated('IMAGE'):
        _edits += 1


def _nodes(tree):
    for node in tree.nodes:
        yield node
        if getattr(node, "node_tree", None) is not None:
            yield from _nodes(node.node_tree)


SKIPPED = {"rna_type", "location", "location_absolute", "width", "height", "select", "show_options", "show_preview", "show_texture",
           "dimensions", "is_active_output", "preview", "warning_propagation", "original", "library", "session_uid", "users", "tag",
           "is_evaluated", "is_updated", "is_runtime_data", "name_full", "links", "internal_links", "interface", "view_center",
           "pixels", "bindcode", "packed_files", "packed_file", "render_slots", "asset_data", "annotation", "animation_data",
           "is_dirty", "lightgroup", "mist_settings", "light_settings", "use_nodes"}
"""Properties that do not change what a world looks like, or that others tell."""


def facts(thing, met=None) -> list:
    """Everything that can be said of a block of data, as values that can be compared; blocks that it uses included."""
    met = set() if met is None else met
    if thing.as_pointer() in met:
        return []
    met.add(thing.as_pointer())
    found = []
    for prop in thing.bl_rna.properties:
        if prop.identifier in SKIPPED:
            continue
        value = getattr(thing, prop.identifier)
        if prop.type == 'COLLECTION':
            found += [(prop.identifier, facts(item, met)) for item in value]
        elif prop.type == 'POINTER':
            if value is not None:
                found.append((prop.identifier, getattr(value, "name", ""), facts(value, met)))
        elif getattr(prop, "is_array", False):
            found.append((prop.identifier, tuple(value)))
        else:
            found.append((prop.identifier, value if not isinstance(value, set) else sorted(value)))
    if isinstance(thing, bpy.types.NodeTree):
        found += [(link.from_node.name, link.from_socket.identifier, link.to_node.name, link.to_socket.identifier, link.is_muted)
                  for link in thing.links]
    return found
