# SPDX-License-Identifier: GPL-3.0-or-later
"""File > Export > 4D Gaussians: Web Page: the scene's splats as one HTML file that plays them."""
import tempfile
from pathlib import Path

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, FloatVectorProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from ..engine import scene_linear
from ..fastgs_blender.formats import web
from ..fastgs_blender.formats.web.long import compressed_clips, in_pieces
from ..fastgs_blender.formats.web.page import Page
from ..scene import objects, web_scene
from ..scene.background import in_background, relayed
from .action import check_frames, draw_column, draw_options
from .exporting import Exporting


class FASTGS_OT_export_page(Exporting, bpy.types.Operator, ExportHelper):
    """Export the splats as a web page: one file that plays them in any browser, without a network"""

    bl_idname = "fastgs.export_page"
    bl_label = "Export Web Page"
    doing = "Exporting a web page"

    filename_ext = ".html"
    filter_glob: StringProperty(default="*.html", options={'HIDDEN'})
    title: StringProperty(name="Title", description="The page's title; empty: the name of its file", options={'SKIP_PRESET'})
    selected: BoolProperty(name="Selected Objects", description="Only the selected objects, else all that final frames show", default=False)
    frame_start: IntProperty(name="Start", description="First frame of the scene that the page plays", default=1, options={'SKIP_PRESET'})
    frame_end: IntProperty(name="End", description="Last frame of the scene that the page plays", default=250, options={'SKIP_PRESET'})
    loop: BoolProperty(name="Loop", description="Begin again after the last frame", default=True)
    move: BoolProperty(
        name="Camera Move", description="Begin with the motion of the scene's camera, until a hand takes the view over; else with its view "
        "on the first frame", default=True)
    sound: BoolProperty(name="Sound", description="Take the sound of the sequencer and of the scene's speakers along", default=True)
    background: EnumProperty(
        name="Background", description="What lies behind the splats",
        items=(
            ('WORLD', "World", "The world's colour, as final frames show it; black where the film is transparent", 0),
            ('COLOUR', "Colour", "Another colour", 1),
        ), default='WORLD')
    colour: FloatVectorProperty(name="Colour", description="The page's background", subtype='COLOR', min=0, max=1, default=(0, 0, 0))
    quality: EnumProperty(
        name="Quality", description="How finely the page holds the models",
        items=(
            ('FINE', "Fine", "Pictures lose at most 0.1 dB; compressed files of FAST-GS are taken as they are", 0),
            ('SMALL', "Small", "Pictures lose at most 0.3 dB; takes minutes", 1),
        ), default='FINE')
    limit: FloatProperty(
        name="Limit (MB)", description="A larger page is not written; 0 is no limit. Phones may refuse more than 32 MB", default=0, min=0,
        soft_max=100, precision=0)

    def invoke(self, context, event):
        self._fill_frames(context.scene)
        return super().invoke(context, event)

    def execute(self, context):
        self._fill_frames(context.scene)
        return super().execute(context)

    def _fill_frames(self, scene) -> None:
        """Frames that nobody has named are the scene's, or those of its preview."""
        part = "frame_preview" if scene.use_preview_range else "frame"
        self.fill(frame_start=getattr(scene, f"{part}_start"), frame_end=getattr(scene, f"{part}_end"))

    def draw(self, context):
        layout = draw_options(self, "title", "selected")
        draw_column(layout, self, "frame_start", "frame_end", align=True)
        layout.prop(self, "loop")
        draw_column(layout, self, "move", active=context.scene.camera is not None)
        draw_column(layout, self, "sound", active=web_scene.has_sound(context.scene))
        layout.prop(self, "background")
        if self.background == 'COLOUR':
            layout.prop(self, "colour")
        layout.prop(self, "quality")
        layout.prop(self, "limit")
        self.draw_losses(context)

    def losses(self, context) -> list[str]:
        """What the page would not show of what final frames do."""
        web_scene.check(context, self._chosen)
        return web_scene.not_kept(context)

    def _chosen(self, obj) -> bool:
        return not obj.original.hide_render and (not self.selected or obj.original.select_get())

    def write(self, context, target: Path):
        """Yields the progress; returns what was written, in words."""
        check_frames(self)
        self._remarks += [f"The page does not show: {text}." for text in web_scene.not_kept(context)]
        sampling = web_scene.sampled(context, self.frame_start, self.frame_end, self._chosen, self.move)
        shown, eyes, paths = yield from relayed(sampling, lambda step: (*step, "reading frames"))
        page = self._page(context, target, shown, eyes)
        level = web.Loss.of(self.quality.lower())
        kept = {} if self.quality == 'SMALL' else self._kept(context, page)
        clips = {stands: Path(path) for stands, path in paths.items()}
        saving = in_background(lambda progress: self._save(page, target, level, kept, clips, progress))
        yield from relayed(saving, lambda share: (share, 1, "compressing"))
        return f"a page of {target.stat().st_size / 1e6:.1f} MB to {target.name}"

    def _page(self, context, target: Path, shown, eyes) -> Page:
        """The page of what was sampled, but for its poster."""
        scene = context.scene
        background = web_scene.background_of(context) if self.background == 'WORLD' else np.array(self.colour)
        sound = web_scene.sound(scene, self.frame_start) if self.sound and web_scene.has_sound(scene) else None
        return Page(shown, eyes, self.title.strip() or target.stem, self.frame_end + 1 - self.frame_start,
                    scene.render.fps / scene.render.fps_base, self.loop, background.tolist(),
                    web_scene.pivot_of(context, eyes[0]).tolist(), sound=sound)

    def _kept(self, context, page: Page) -> dict:
        """The files of models that are compressed already, where the page shows all of the model."""
        models, kept = set(page.models.values()), {}
        for obj in context.view_layer.objects:
            path = objects.abspath(obj) if objects.is_splat(obj) else ""
            model = objects.load_model(path) if Path(path).is_file() else None
            if model in models and model not in kept:
                data = web.kept_file(Path(path))
                kept |= {model: data} if data else {}
        return kept

    def _save(self, page: Page, target: Path, level, kept, clips, progress):
        """Write the page; clips: the files of its long clips, of which a piece at a time is in memory."""
        ready = {stands: path for stands, path in clips.items() if self.quality == 'FINE' and web.is_compressed(path)}
        sources = {stands: objects.load_model(str(path)) for stands, path in clips.items()}
        with self.listening(), tempfile.TemporaryDirectory(prefix="fastgs-") as folder:
            page, files = compressed_clips(page, sources, ready, level, Path(folder), progress)
            page, pieces = in_pieces(page, files, _linear)
            web.save_page(page, target, level, self.limit or None, progress, kept | pieces)


def _linear(instances, camera):
    image = scene_linear.render(instances, camera, np.eye(3, dtype=np.float32))
    return image["rgb"], image["alpha"]
