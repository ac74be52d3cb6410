# SPDX-License-Identifier: GPL-3.0-or-later
"""The compiled stages of a device, and the groups of buffers that they are given.

Making a group takes longer than all else that Python does for a stage.  The buffers of a frame are those of the one before, so groups are
kept; a stage's parameters lie at another place of their buffer each time, which is given with the dispatch.
"""
import re
from dataclasses import dataclass, field
from typing import Any

from . import shaders

KEPT = 4096
"""Groups that are kept to be used again."""
KINDS = {"read": "read-only-storage", "read_write": "storage"}
"""WebGPU's name of a binding for each access that a shader declares."""


@dataclass(frozen=True, eq=False)
class Pipeline:
    """A compiled stage, and the layout of its bindings: wgpu's GPUComputePipeline and GPUBindGroupLayout."""

    native: Any
    layout: Any


def compiled(device: Any, stage: str, subgroups: bool, constants: dict) -> Pipeline:
    """A stage (wgsl/<stage>.wgsl) with its constants, for wgpu's GPUDevice."""
    import wgpu

    code = shaders.source(stage, subgroups, **constants)
    buffers = [{"type": "uniform", "has_dynamic_offset": True}]
    buffers += [{"type": KINDS[access]} for _, access in sorted(re.findall(r"@binding\((\d)\) var<storage, (\w+)>", code))]
    layout = device.create_bind_group_layout(entries=[
        {"binding": number, "visibility": wgpu.ShaderStage.COMPUTE, "buffer": buffer} for number, buffer in enumerate(buffers)])
    pipeline = device.create_compute_pipeline(
        layout=device.create_pipeline_layout(bind_group_layouts=[layout]),
        compute={"module": device.create_shader_module(code=code, label=stage), "entry_point": "main"})
    return Pipeline(pipeline, layout)


@dataclass(eq=False)
class Groups:
    """Groups of bound buffers.  A kept group keeps its buffers' memory: whoever frees one calls forget()."""

    kept: dict[tuple, tuple] = field(default_factory=dict)  # with the buffers, so that their ids in the keys stay theirs
    bound: set[int] = field(default_factory=set)  # ids of the buffers in them

    def forget(self, native: Any = None) -> None:
        """Let all groups go, or only if one of them holds a buffer."""
        if native is None or id(native) in self.bound:
            self.kept.clear()
            self.bound.clear()

    def get(self, device: Any, pipeline: Pipeline, parameters: tuple[Any, int], buffers: list[tuple[Any, int, int]]) -> Any:
        """wgpu's GPUBindGroup of parameters (their buffer, bytes of a stage's) and buffers (buffer, first byte, bytes)."""
        key = id(pipeline), id(parameters[0]), parameters[1], *((id(native), first) for native, first, _ in buffers)
        if key not in self.kept:
            if len(self.kept) == KEPT:
                self.forget()
            given = [(parameters[0], 0, parameters[1]), *buffers]
            entries = [{"binding": number, "resource": {"buffer": native, "offset": first, "size": size}}
                       for number, (native, first, size) in enumerate(given)]
            self.kept[key] = device.create_bind_group(layout=pipeline.layout, entries=entries), pipeline, given
            self.bound.update(id(native) for native, _, _ in buffers)
        return self.kept[key][0]
