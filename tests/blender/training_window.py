# SPDX-License-Identifier: GPL-3.0-or-later
"""Stories of training in Blender's window (see inside.py and window.py): the open scene is filmed, trained on, and rendered."""
from __future__ import annotations

import os

import addon_utils
import bpy
from background import ADDON, look
from held_runs import Barrier
from mathutils import Euler
from on_gpu import build, part
from window import area_of, f12, press, settled, shot, sidebar, turns, until, within


def toy():
    """on_gpu.build() in a window."""
    bpy.ops.wm.read_homefile(use_empty=True)
    with within(area_of()):
        return build()


def set_the_table():
    """The panel of training open, a wide 3D view, an Image Editor and a Text Editor beside it."""
    panels = [cls for cls in part("ui").CLASSES if getattr(cls, "bl_category", "") == "FAST-GS" and not hasattr(cls, "bl_parent_id")]
    addon_utils.disable(ADDON)
    for cls in panels:  # as the user would leave them: one open, the others not
        cls.bl_options = set() if cls.__name__ == "FASTGS_PT_training" else {'DEFAULT_CLOSED'}
    addon_utils.enable(ADDON)
    with within(area_of('DOPESHEET_EDITOR')):
        bpy.ops.screen.area_close()
    area_of('PROPERTIES').type = 'IMAGE_EDITOR'
    area_of('OUTLINER').type = 'TEXT_EDITOR'
    yield from turns()
    beside, below = area_of('TEXT_EDITOR'), area_of('IMAGE_EDITOR')
    for x, y, delta in ((beside.x - 2, beside.y + 20, -120), (below.x + 20, below.y + below.height, -60)):
        with within(beside):
            bpy.ops.screen.area_move(x=x, y=y, delta=delta)
        yield from turns()
    area = area_of()
    view = area.spaces.active.region_3d
    view.view_rotation = Euler((1.15, 0, 0.5)).to_quaternion()
    view.view_location, view.view_distance = (0, 0, 0.6), 6.0
    yield from sidebar(area)
    return area


def click(area, command, across=0.5):
    """Press the button of the sidebar that runs an operator: Blender says which one is under the mouse."""
    window = bpy.context.window_manager.windows[0]
    region = next(region for region in area.regions if region.type == 'UI')
    x = int(region.x + across * region.width)
    region.tag_redraw()
    yield from turns()
    for y in range(region.y + region.height - 10, region.y, -9):
        window.event_simulate(type='MOUSEMOVE', value='NOTHING', x=x, y=y)
        yield from turns(2)
        bpy.context.window_manager.clipboard = ""
        with bpy.context.temp_override(window=window, area=area, region=region):
            if bpy.ops.ui.copy_python_command_button.poll():
                bpy.ops.ui.copy_python_command_button()
        if bpy.context.window_manager.clipboard.startswith(f"bpy.ops.{command}("):
            break
    else:
        raise AssertionError(f"the sidebar has no button {command}")
    for value in ('PRESS', 'RELEASE'):
        window.event_simulate(type='LEFTMOUSE', value=value, x=x, y=y)
        yield from turns()
    x, y = area.x + area.width // 4, area.y + area.height // 4
    window.event_simulate(type='MOUSEMOVE', value='NOTHING', x=x, y=y)  # away from where a tooltip would come
    yield from turns()


def held_filming():
    """Film a picture at a time, and none after the second until the function that is returned has been called."""
    stepwise, progress, released = part("operators.stepwise").Stepwise, part("scene.filming.progress"), []
    go_on = stepwise._go_on

    def until_released(self, context, seconds):
        held = not released and progress.current is not None and progress.current.made > 1
        return None if held else go_on(self, context, 0.0)

    def release():
        released.append(True)
        stepwise._go_on = go_on

    stepwise._go_on = until_released
    return release


def from_scene_to_shot(environment, cache):
    """The panel's Train button on the open scene; screenshots while it trains and of what it brings; F12 of that, and of the truth.

    Filming and training are held while they are looked at: a quick machine would have finished them.
    """
    os.environ["FASTGS_CACHE_DIR"] = cache
    barrier = Barrier(os.path.abspath("training-barrier"))
    os.environ.update(barrier.variables)
    scene = toy()
    yield from turns()
    area = yield from set_the_table()
    preferences = bpy.context.preferences.addons[ADDON].preferences
    preferences.training_choice, preferences.training_python = 'CHOSEN', environment
    settings, train = scene.fastgs.training, part("operators.train")
    options = train.arguments
    train.arguments = lambda chosen: [*options(chosen), "--set", "checkpoint_seconds=1"]
    settings.source, settings.preset, settings.iterations, settings.max_gaussians = 'SCENE', 'DRAFT', 500, 4000
    settings.width, settings.height, settings.count, settings.samples, settings.frame_step = 160, 120, 8, 4, 2
    watch, displays, progress = part("scene.training.watch"), part("scene.training.displays"), part("scene.filming.progress")
    yield from settled("train-panel")
    half = settings.iterations // 2
    barrier.hold_at(f"step {half}")
    release = held_filming()
    yield from click(area, "fastgs.train")
    yield from until(lambda: progress.current and progress.current.made > 1)
    filming = [progress.current.done, progress.current.total]
    view = area.spaces.active.region_3d
    before = view.view_rotation.copy()
    yield from press('NUMPAD_6', area)  # the view turns meanwhile
    moved = lambda: before.rotation_difference(view.view_rotation).angle > 0.1  # noqa: E731
    yield from until(moved)
    turned = moved() and progress.current is not None
    shot("filming")
    release()
    if not (yield from until(watch.found)):
        raise AssertionError("nothing is trained")
    job = watch.found()[0][0]
    yield from turns(10)
    shot("run-appears")
    settings.source = 'FOLDER'  # a shorter panel: all of the run is in sight
    kinds, texts = [], set()
    images = area_of('IMAGE_EDITOR').spaces.active

    def look_at():
        kind = watch.found()[0][1].kind
        if kind not in kinds:
            kinds.append(kind)
        texts.add(watch.line())
        images.image = bpy.data.images.get(displays.PREVIEW)
        return kind

    area_of('TEXT_EDITOR').spaces.active.text = None
    yield from until(lambda: look_at() in ('FINISHED', 'FAILED') or barrier.reached.exists())
    yield 2.0  # so that a checkpoint is due after this step
    barrier.hold_at(f"step {half + 1}")
    yield from until(lambda: look_at() in ('FINISHED', 'FAILED') or (barrier.reached.exists() and images.image and "left" in watch.line()))
    log = area_of('TEXT_EDITOR').spaces.active
    log.text, log.top = bpy.data.texts.get(displays.LOG), 0
    with within(area_of('IMAGE_EDITOR')):
        bpy.ops.image.view_all(fit_view=True)
    yield from turns()
    shot("training")
    with within(area):
        bpy.ops.fastgs.train_import('INVOKE_DEFAULT')
    so_far = yield from until(lambda: next((obj for obj in scene.objects if "fastgs_job" in obj), None))
    seen = so_far is not None and so_far.fastgs.filepath.endswith("so-far.safetensors")
    barrier.release()
    yield from until(lambda: look_at() in ('FINISHED', 'FAILED'))
    state = watch.found()[0][1]
    if state.kind == 'FAILED':
        raise AssertionError(state.text)
    yield from until(lambda: any(obj.fastgs.filepath.endswith("model.safetensors") for obj in scene.objects))
    model = next(obj for obj in scene.objects if "fastgs_job" in obj)
    hidden = sorted(obj.name for obj in scene.objects if obj.hide_get() and obj.hide_render)
    yield from turns()
    shot("notified")
    window = bpy.context.window_manager.windows[0]
    window.event_simulate(type='ESC', value='PRESS')
    window.event_simulate(type='ESC', value='RELEASE')
    yield from turns()
    for obj in scene.objects:
        obj.hide_set(obj != model)
    yield from click(area, "fastgs.train_report", 0.8)
    yield from settled("report")
    yield from press('ESC', area)
    bpy.ops.fastgs.train_report()
    scene.frame_set(3)
    yield from settled("trained")

    yield from click(area, "fastgs.train_check", 0.3)
    yield from until(lambda: part("fastgs_blender.jobs.checks").latest)
    checked = part("fastgs_blender.jobs.checks").latest.text

    for obj in scene.objects:
        obj.hide_render = obj == model
    camera = look(scene, 320, 240, eye=(-1.6, -3.8, 1.9), target=(0, 0, 0.6), lens=40)
    scene.render.film_transparent, scene.cycles.samples = False, 16
    scene.render.filepath = os.path.abspath("toy-truth.png")
    bpy.ops.render.render(write_still=True)
    for obj in scene.objects:
        obj.hide_render = obj != model
    scene.render.engine = 'FASTGS'
    yield from f12(area)
    shot("trained-f12")
    bpy.data.images["Render Result"].save_render(os.path.abspath("toy-model.png"))
    report = bpy.data.texts["FAST-GS Report"].as_string()
    again = yield from train_again(area, settings, job, barrier)
    return {"kinds": kinds, "lines": sorted(texts), "camera": camera, "matrix": [list(row) for row in model.matrix_world],
            "gaussians": model.fastgs.gaussian_count, "python": job.python, "report": report, "checked": checked, "filming": filming,
            "turned": turned, "seen": seen, "hidden": hidden, "again": again}


def train_again(area, settings, job, barrier):
    """The Train button once more, into the folder of the finished run, which is begun anew: the states that the new job goes through."""
    watch = part("scene.training.watch")
    area.type = 'VIEW_3D'  # F12 has put the picture there
    yield from turns()
    settings.out, settings.existing, settings.iterations = job.out, 'OVERWRITE', 60
    yield from sidebar(area)
    shot("train-again")
    barrier.hold_at("step 30")
    yield from click(area, "fastgs.train", 0.8)
    kinds = []

    def look_at():
        kind = watch.refresh()[-1][1].kind
        if kinds[-1:] != [kind]:
            kinds.append(kind)
        return kind

    yield from until(lambda: look_at() in ('FINISHED', 'FAILED') or barrier.reached.exists())
    look_at()
    barrier.release()
    yield from until(lambda: look_at() in ('FINISHED', 'FAILED'))
    new, state = watch.refresh()[-1]
    yield from until(lambda: bpy.context.window_manager.windows[0].modal_operators or new.reported, 2)
    yield from press('ESC', area)  # the popup that tells of the end
    yield from click(area, "fastgs.train_forget", 0.81)
    yield from settled("asked")
    listed = len(watch.refresh())
    yield from press('RET', area)
    yield from until(lambda: len(watch.refresh()) < listed)
    return {"kinds": kinds, "another": new.id != job.id, "steps": state.values.get("iterations"), "text": state.text,
            "listed": [listed, len(watch.refresh())]}
