# SPDX-License-Identifier: GPL-3.0-or-later
"""File > Export > 4D Gaussians: a frame or a range of frames as static files, or the active object's whole model."""
from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from .. import fastgs_blender as fg
from ..fastgs_blender import formats
from ..fastgs_blender.formats.scenes import as_seen
from ..fastgs_blender.formats.usd import save_samples
from ..fastgs_blender.model.chapters import Chapters
from ..scene import objects, snapshot
from ..scene.background import in_background, relayed
from ..scene.splats import parting
from .action import check_frames, draw_column, draw_options
from .exporting import Exporting

SAMPLE = 200
"""Gaussians of each object that are looked at to say what a format cannot hold."""
STATIC = (
    ('PLY', "PLY", ".ply", "The PLY of 3D Gaussian splatting, which most programs read"),
    ('COMPRESSED_PLY', "Compressed PLY", ".compressed.ply", "PlayCanvas' and SuperSplat's packed PLY"),
    ('SPZ', "SPZ", ".spz", "Niantic's packed format"),
    ('SOG', "SOG", ".sog", "PlayCanvas' format of packed pictures"),
    ('SPLAT', "Splat", ".splat", "antimatter15's format, without view-dependent colour"),
    ('USD', "OpenUSD", ".usdc", "ParticleField3DGaussianSplat of OpenUSD 26.03; a frame range becomes time samples"),
    ('GLTF', "glTF", ".glb", "Binary glTF with KHR_gaussian_splatting"),
)
MOVING = (
    ('OWN', "FAST-GS", ".safetensors", "Our own format, which holds everything"),
    ('COMPRESSED', "FAST-GS, Compressed", ".safetensors", "Our own format, packed so that pictures lose at most 0.1 dB"),
    ('STG', "Spacetime Gaussians PLY", ".ply", "The PLY of Spacetime Gaussians, with a decoder beside it where the model has one"),
    ('FREE_TIME', "FreeTimeGS PLY", ".ftgs.ply", "The PLY of FreeTimeGS and the FTGS player: straight motion, bell-shaped lives"),
    ('FOUR_DGS', "4dgs", ".4dgs", "avala-ai's container: straight motion, bell-shaped lives, quantised"),
    ('SPLATV', "splaTV", ".splatv", "The format of the web viewer splaTV"),
    ('SMALL', "FAST-GS, Small", ".safetensors", "Our own format, packed so that pictures lose at most 0.3 dB; takes minutes"),
)
LEVELS = {'COMPRESSED': "fine", 'SMALL': "small"}
"""How far the compressed variants of our own format go."""


def _items(kinds):
    return tuple((key, label, description, number) for number, (key, label, _, description) in enumerate(kinds))


class FASTGS_OT_export(Exporting, bpy.types.Operator, ExportHelper):
    """Export what splat objects show as files for other programs"""

    bl_idname = "export_scene.fastgs"
    bl_label = "Export 4D Gaussians"
    doing = "Exporting splats"

    filename_ext = ".ply"
    filter_glob: StringProperty(default=";".join(f"*{extension}" for extension in formats.writable()), options={'HIDDEN'})
    content: EnumProperty(
        name="Content", description="What the file holds",
        items=(
            ('FRAME', "Frame", "What the scene shows on this frame, as one static file: with transforms, looks, crops and times", 0),
            ('RANGE', "Frame Range", "The same for each frame of a range, as numbered files", 1),
            ('MODEL', "4D Model", "The active object's model with its motion and its parts", 2),
        ), default='FRAME')
    static_format: EnumProperty(name="Format", description="The kind of file", items=_items(STATIC), default='PLY')
    moving_format: EnumProperty(name="Format", description="The kind of file", items=_items(MOVING), default='OWN')
    selected: BoolProperty(
        name="Selected Objects", description="Only the selected objects, else all that the view layer shows", default=False)
    frame_start: IntProperty(name="Start", description="First frame of the scene to export", default=1)
    frame_end: IntProperty(name="End", description="Last frame of the scene to export", default=250)

    def invoke(self, context, event):
        self.frame_start, self.frame_end = context.scene.frame_start, context.scene.frame_end
        return super().invoke(context, event)

    @property
    def extension(self) -> str:
        """The extension of the chosen format."""
        chosen, kinds = (self.moving_format, MOVING) if self.content == 'MODEL' else (self.static_format, STATIC)
        return next(extension for key, _, extension, _ in kinds if key == chosen)

    def check(self, context):
        """Give the name the chosen format's extension."""
        before, path = self.filepath, self.filepath
        for extension in sorted(formats.writable(), key=len, reverse=True):
            if path.lower().endswith(extension):
                path = path[:-len(extension)]
                break
        self.filepath = (path or "untitled") + self.extension
        return self.filepath != before

    def draw(self, context):
        layout = draw_options(self, "content", "moving_format" if self.content == 'MODEL' else "static_format")
        if self.content != 'MODEL':
            layout.prop(self, "selected")
        if self.content == 'RANGE':
            draw_column(layout, self, "frame_start", "frame_end", align=True)
        self.draw_losses(context)

    def losses(self, context) -> list[str]:
        """What the chosen format cannot hold of what would be written, found on a few Gaussians of each object."""
        if self.content == 'MODEL':
            model = _model(context)
            if isinstance(model, Chapters):
                formats.writer_of_chapters(Path("x" + self.extension))
                model = model.moment(0.0)[0]
            return self._writer(few(model)).losses(few(model))
        model, lost = self._shown(context, lambda instance: instance.part(some(instance.model)))
        return list(dict.fromkeys([*lost, *self._writer(model).losses(model)]))

    def _writer(self, model):
        if self.content == 'MODEL' and self.moving_format in LEVELS:
            return formats.Native(formats.Loss.of(LEVELS[self.moving_format]))
        return formats.writer_of(model, Path("x" + self.extension))

    def _shown(self, context, take=lambda instance: instance):
        """The scene at its current frame as one static model, and clauses on losses."""
        depsgraph = context.evaluated_depsgraph_get()
        chosen = (lambda obj: obj.original.select_get()) if self.selected else (lambda obj: True)
        instances, left_out = snapshot.take(depsgraph, chosen, rendered=False, final=True).load()
        if left_out:
            raise fg.FastGSError(f"{left_out[0][0]} cannot be exported: {left_out[0][1]}")
        return as_seen([take(instance) for instance in instances], formats.says_antialiased(self.extension))

    def write(self, context, target: Path):
        """Yields the progress; returns what was written, in words."""
        if self.content == 'RANGE':
            check_frames(self)
            return (yield from self._write_range(context, target))
        with self.listening():
            model = _model(context) if self.content == 'MODEL' else self._shown(context)[0]
        level = LEVELS.get(self.moving_format) if self.content == 'MODEL' else None
        yield from relayed(in_background(lambda progress: self._save(model, target, level, progress)), lambda share: (share, 1))
        return f"{len(model):,} Gaussians"

    def _write_range(self, context, target: Path):
        scene, count = context.scene, self.frame_end + 1 - self.frame_start
        before = scene.frame_current, scene.frame_subframe
        digits = max(4, len(str(self.frame_end)))
        stem = target.name[:-len(self.extension)] if target.name.endswith(self.extension) else target.stem
        try:
            if self.static_format == 'USD':  # one file, whose frames are asked for while it is written
                with self.listening():
                    save_samples(target, self._frames(context, count), scene.render.fps / scene.render.fps_base)
            else:
                self.interrupted = "The export was cancelled; the files of {} are kept"
                for done, (frame, model) in enumerate(self._frames(context, count)):
                    self._save(model, target.with_name(f"{stem}_{frame:0{digits}d}{self.extension}"))
                    yield done + 1, count
        finally:
            scene.frame_set(before[0], subframe=before[1])
        return f"{count:,} frames"

    def _frames(self, context, count):
        """(frame, what the scene shows on it) for each frame of the range."""
        for done in range(count):
            context.scene.frame_set(self.frame_start + done)
            with self.listening():
                model = self._shown(context)[0]
            yield self.frame_start + done, model
            self._show(context, done + 1, count)

    def _save(self, model, target: Path, level: str | None = None, progress=None):
        with self.listening():
            fg.save(model, target, level, progress)


def few(model: fg.GaussianModel) -> fg.GaussianModel:
    """Some Gaussians of a model."""
    return model.take(some(model))


def some(model: fg.GaussianModel) -> np.ndarray:
    """The indices of some Gaussians of a model."""
    return np.arange(0, len(model), max(1, len(model) // SAMPLE))


def _model(context) -> fg.GaussianModel | Chapters:
    """The active object's model, or its clip in chapters; raises FastGSError where it has none."""
    obj = context.object
    if obj is None or not objects.is_splat(obj):
        raise fg.FastGSError("the active object shows no splats; make the object active whose model is to be exported.")
    source = objects.source_of(obj)
    if isinstance(source, Chapters):
        return source
    if not isinstance(source, fg.GaussianModel):
        raise fg.FastGSError(f"{obj.name} shows a sequence, which is no one model; export its frames, or fit a model with fastgs convert.")
    return parting.with_parts_joined(obj)
