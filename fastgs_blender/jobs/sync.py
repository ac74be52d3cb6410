# SPDX-License-Identifier: GPL-3.0-or-later
"""`fastgs sync` in a process of the training Python, and its result as texts.  No bpy here."""
from .command import StagedCommand


class Sync(StagedCommand):
    """The comparison of the clocks of a capture's cameras."""

    def __init__(self, python: str, capture: str) -> None:
        super().__init__(python, ["sync", capture, "--quiet"], "comparing the clocks", capture)


def text_of(capture: str, values: dict) -> str:
    """A line for each camera: its offset [frames], and how sure that is."""
    lines = [f"Clocks of {capture}, in frames, found by {values['found_by']}", ""]
    spread = values["uncertainty"]
    for view, offset in values["offsets"].items():
        sure = f"+- {spread[view]:.2f}" if view in spread else ""
        if view in values["lost"]:
            sure = "its pose is wrong" if view in values["misplaced"] else "unsure"
        lines.append(f"{view:24} {offset:+8.2f}  {sure}".rstrip())
    return "\n".join([*lines, "", f"Written to {values['file']}, with which training uses them.", f"The picture is {values['picture']}."])


def summary_of(values: dict) -> str:
    """One sentence."""
    view, most = max(values["offsets"].items(), key=lambda item: abs(item[1]))
    if abs(most) < 0.1:
        return "The cameras' clocks agree to a tenth of a frame"
    return f"The clocks differ by up to {abs(most):.2f} frames ({view}); sync.json says so to training"
