# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's preferences."""
import bpy

from ..engine import compiling
from ..fastgs_blender.kernels.cpu import cache
from ..fastgs_blender.util.threads import available
from ..fastgs_blender.util.verdicts import read_verdict
from ..scene import devices, settings
from ..scene.training import installation
from .object_panels import draw_rows, draw_trouble, split


def _apply(self, context):
    settings.apply(self)


class FASTGS_AP_preferences(bpy.types.AddonPreferences):
    """GPU, threads, compiled kernels, log, training Python."""

    bl_idname = settings.EXTENSION

    gpu: bpy.props.StringProperty(
        name="GPU", description="The GPU that scenes with the device GPU use; empty for one that is faster than the processor",
        update=_apply)
    threads: bpy.props.IntProperty(
        name="Threads", description="Threads for rendering where the scene does not fix their number; 0 takes all processors",
        default=0, min=0, max=1024, update=_apply)
    cache_folder: bpy.props.StringProperty(
        name="Cache Folder", description="Where the compiled renderer is kept; empty for the extension's own folder",
        subtype='DIR_PATH', update=_apply)
    log_level: bpy.props.EnumProperty(
        name="Log", description="What is written to the console",
        items=(('ERROR', "Errors", "Only what went wrong", 0), ('WARNING', "Warnings", "Also what may surprise", 1),
               ('INFO', "Information", "Also what is being done", 2), ('DEBUG', "Everything", "For finding mistakes", 3)),
        default='WARNING', update=_apply)

    training_choice: bpy.props.EnumProperty(
        name="Training Python", description="The Python that trains, in a process of its own",
        items=(('AUTO', "Automatic", "The environment that was made here, else Blender's own Python", 0),
               ('CHOSEN', "Existing", "An environment of your own", 1)),
        default='AUTO')
    training_python: bpy.props.StringProperty(
        name="Environment", description="Folder of a Python environment that has numba, safetensors, pillow and tqdm, or its python "
        "program", subtype='FILE_PATH')
    package_index: bpy.props.StringProperty(
        name="Package Index", description="Where packages for a new environment come from, as pip's --index-url; empty for the usual one")

    def draw(self, context):
        layout = split(self.layout, decorate=False)

        col = headed(layout, "Rendering")
        draw_gpus(col, context, self.gpu)
        col.prop(self, "threads")
        if not self.threads:
            draw_rows(col, [("", f"all: {available()} on this machine")])
        draw_rows(col, [("Renderer", kernel_state())])
        col.prop(self, "cache_folder")
        row = col.row()
        row.operator("fastgs.compile_kernels", icon='PLAY')
        row.operator("fastgs.clear_kernels", icon='TRASH')

        col = headed(layout, "Training")
        can_make = hasattr(bpy.types, "FASTGS_OT_make_training_python")  # not in the zip for Blender's store
        col.prop(self, "training_choice", text="Python")
        if self.training_choice == 'CHOSEN':
            col.prop(self, "training_python")
        elif can_make:
            col.prop(self, "package_index")
        if installation.is_making():
            draw_rows(col, [("Being Made", installation.maker.last_line[:60])])
        row = col.row()
        row.operator("fastgs.test_training_python", icon='CHECKMARK')
        if can_make:
            row.operator("fastgs.make_training_python", icon='IMPORT')

        col = headed(layout, "Help")
        col.prop(self, "log_level", text="Console Shows")
        row = col.row()
        row.operator("fastgs.open_guide", icon='HELP')
        row.operator("fastgs.copy_diagnostics", icon='COPYDOWN')


def headed(layout, heading: str):
    """A column under a heading.  (Blender draws column(heading=) beside a check box alone.)"""
    col = layout.column()
    col.label(text=heading)
    layout.separator()
    return col


def draw_gpus(layout, context, chosen: str):
    """Draw the GPUs with what their self-test said, of which one is chosen, and the button that tests them."""
    known = devices.found()
    box = layout.column(align=True)
    if known is None:
        draw_rows(box, [("GPU", "being looked for")])
        return
    draw_gpu(box, "", f"Automatic ({known['auto'] or 'the processor'})", not chosen)
    draw_trouble(box, context, known["reason"], 'INFO')
    for each in known["devices"]:
        draw_gpu(box, each["name"], f"{each['name']}: {each['kind']}, {verdict(each)}", each["name"] == chosen)
    if chosen and chosen not in [each["name"] for each in known["devices"]]:
        draw_gpu(box, chosen, f"{chosen}: not there now, the processor is used", True)
    if line := devices.line():
        draw_rows(box, [("Test", line)])
    elif devices.trouble():
        draw_rows(box, [("Test", devices.trouble())])
    box.operator("fastgs.test_gpus", text="Test GPUs", icon='CHECKMARK')


def draw_gpu(layout, name: str, text: str, chosen: bool):
    """Draw the line of a GPU, whose button chooses it."""
    layout.operator("fastgs.use_gpu", text=text, icon='RADIOBUT_ON' if chosen else 'RADIOBUT_OFF').name = name


def verdict(device: dict) -> str:
    """What the self-test of a GPU said, in few words; device is one of devices.found()."""
    found = read_verdict(device)
    if found is None:
        return "not tested yet"
    if found.fault:
        return f"failed its self-test: {found.fault}"
    if found.frame is None or found.step is None:
        return "passed its self-test"
    frame, step = (processor / gpu for gpu, processor in (found.frame, found.step))
    return f"passed its self-test; the processor's speed x {frame:.2g} (frames), x {step:.2g} (training)"


def kernel_state() -> str:
    """One line about the compiled renderer."""
    if not compiling.has_numba():
        return "numba is missing: rendering is done by NumPy, slowly"
    if compiling.is_running():
        return "being compiled now"
    return f"compiled, {cache.size() / 1e6:.1f} MB" if cache.is_filled() else "not compiled yet; the first use does it"
