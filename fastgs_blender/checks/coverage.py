# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures coverage: how many cameras see each part of the scene."""
import numpy as np

from . import drawing
from .drawing import INK, SOFT, text
from .report import Picture, Section, listed
from .samples import Inspection, thumbnail
from .space import Space, space_of

ENOUGH = 3
"""Least number of cameras that must see a place for a reliable depth and colour."""
MUCH = 0.25
"""Share of a camera's picture that may have fewer cameras before it is reported."""
LEVELS, GRID = 5, 72
MOST_PICTURES = 24


def run(inspection: Inspection) -> Section:
    """Count cameras in a ground plan and over each camera's picture, without occlusion, which is not known."""
    section = Section("Coverage", "How many training cameras have a place in their pictures; what hides it from them is not known. Depth "
                                  f"comes from at least two views, and {ENOUGH} make it sure.")
    if not inspection.capture.posed:
        section.summary = "The capture does not say where its cameras are, so that what they see in common is not known yet."
        return section
    if not inspection.training:
        return section
    space = space_of(inspection)
    counts = {view: space.counts(view) for view in inspection.views}
    few = {view: float((count < ENOUGH).mean()) for view, count in counts.items()}
    alone = {view: float((counts[view] < 2).mean()) for view in inspection.training}
    if len(inspection.training) >= ENOUGH:
        lonely = [view for view in inspection.training if few[view] > MUCH]
        worst = sorted(lonely, key=lambda view: -few[view])
        if worst:
            mean = float(np.mean([few[view] for view in inspection.training]))
            section.add("poor", f"{few[worst[0]]:.0%} of the picture of {worst[0]} is seen by fewer than {ENOUGH} cameras, {mean:.0%} over "
                                "all cameras: what is there will be smeared when it is looked at from "
                                f"elsewhere{f' (also {listed(worst[1:], 3)})' if worst[1:] else ''}.",
                        "Turn outer cameras inwards, add cameras there, or keep the final camera away from these parts.", worst,
                        ("share of its picture", round(few[worst[0]], 3), ""))
    section.pictures.append(Picture("What the colours mean: training cameras that see a place.", drawing.key_of_counts(), wide=True))
    section.pictures.append(Picture(f"The scene from above: how many cameras see each place between the floor and the top of "
                                    f"{'what was matched' if space.known else 'where they look'}"
                                    ", the cameras and where they look.", plan(space, inspection), wide=True))
    held_out = set(inspection.capture.held_out_views)
    shown = sorted(inspection.views, key=lambda view: (view not in held_out, -few[view]))[:MOST_PICTURES]
    for view in shown:
        samples = inspection.samples[view]
        role = "held out: " if view in held_out else ""
        section.pictures.append(Picture(f"{view} ({role}{few[view]:.0%} seen by fewer than {ENOUGH})",
                                        pixels=drawing.counts_over(thumbnail(samples[len(samples) // 2].rgb), counts[view])))
    section.columns = {f"Seen by < {ENOUGH}": {view: f"{value:.0%}" for view, value in few.items()}}
    section.measures = {"seen_by_fewer_than_3": {view: round(value, 4) for view, value in few.items()},
                        "seen_by_one": {view: round(value, 4) for view, value in alone.items()}, "points": len(space.points)}
    return section


def plan(space: Space, inspection: Inspection) -> str:
    """The scene from above as SVG."""
    centres = space.planned(np.array([camera.centre for camera in space.cameras.values()]))
    low, high = space.box
    left = np.minimum(low[:2], centres[:, :2].min(0))
    right = np.maximum(high[:2], centres[:, :2].max(0))
    pad = 0.06 * max(*(right - left), 1e-9)
    left, right = left - pad, right + pad
    width = 640.0
    scale = width / max(right[0] - left[0], (right[1] - left[1]) / 0.9, 1e-9)
    size = (right - left) * scale

    def at(points: np.ndarray) -> np.ndarray:
        return np.stack([(points[..., 0] - left[0]) * scale, size[1] - (points[..., 1] - left[1]) * scale], -1)

    cell = max(size) / GRID
    x, y = np.meshgrid(np.arange(cell / 2, size[0], cell), np.arange(cell / 2, size[1], cell))
    ground = np.stack([left[0] + x / scale, left[1] + (size[1] - y) / scale], -1)
    heights = np.linspace(low[2], high[2], LEVELS + 2)[1:-1]
    seen = np.median([space.seen(space.world(np.concatenate([ground.reshape(-1, 2), np.full((x.size, 1), h)], 1))) for h in heights], 0)
    seen = seen.reshape(x.shape).astype(int)
    parts = [f'<rect width="{size[0]:.0f}" height="{size[1]:.0f}" fill="#f4f4f4"/>']
    for (row, column), count in np.ndenumerate(seen):
        if count:
            colour = drawing.hexed(drawing.COUNTS[min(count, len(drawing.COUNTS) - 1)])
            parts.append(f'<rect x="{x[row, column] - cell / 2:.1f}" y="{y[row, column] - cell / 2:.1f}" width="{cell + 0.3:.1f}" '
                         f'height="{cell + 0.3:.1f}" fill="{colour}" '
                         'fill-opacity="0.55"/>')
    if space.known:
        spots = at(space.planned(space.points[:: max(1, len(space.points) // 600)]))
        parts += [f'<circle cx="{a:.1f}" cy="{b:.1f}" r="1.4" fill="{INK}" fill-opacity="0.55"/>' for a, b in spots
                  if 0 <= a <= size[0] and 0 <= b <= size[1]]
    for view, camera in space.cameras.items():
        place = at(space.planned(camera.centre[None]))[0]
        toward: np.ndarray = space.planned(camera.world_to_camera[2:3, :3])[0, :2] * [1, -1]
        length = float(np.linalg.norm(toward))
        toward = toward / max(length, 1e-9)
        half = np.arctan(camera.width / 2 / camera.fx)
        wedge = [place + 34 * (np.array([[np.cos(t), -np.sin(t)], [np.sin(t), np.cos(t)]]) @ toward) for t in (-half, half)]
        held_out = view in inspection.capture.held_out_views
        colour = "#7a3fb0" if held_out else "#1d4f91"
        if length > 0.2:
            corners = " ".join(f"{a:.1f},{b:.1f}" for a, b in (place, *wedge))
            parts.append(f'<polygon points="{corners}" fill="{colour}" fill-opacity="0.25" stroke="{colour}"/>')
        parts.append(f'<circle cx="{place[0]:.1f}" cy="{place[1]:.1f}" r="4" fill="{colour}"/>')
        parts.append(text(place[0], place[1] - 8, view + (" (held out)" if held_out else ""), "middle", INK, 'font-size="11"'))
    parts.append(text(8, size[1] - 8, "from above; dots: matched features; violet: held out", colour=SOFT))
    return drawing.svg(size[0], size[1], parts)
