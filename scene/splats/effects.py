# SPDX-License-Identifier: GPL-3.0-or-later
"""Effects: node groups that change the points of splat objects with *Modifiers Change: Splats*, and so their Gaussians.

Each is built by code in the open file, with the nodes that all supported releases of Blender have.  At 0 an effect changes nothing.
"""
from collections.abc import Callable
from dataclasses import dataclass, field

import bpy

from .. import point_edits
from ..node_trees import Builder, find_socket
from .proxy_nodes import keep_last, modifier_of

VERSION = 1
"""Of the effects: the file of the asset library is named by it."""


def set_input(modifier: bpy.types.Modifier, name: str, value) -> None:
    """Set an input of a modifier's node group by its name; Blender 5.2 keeps it elsewhere than its predecessors."""
    identifier = next(i.identifier for i in modifier.node_group.interface.items_tree if i.name == name and i.in_out == 'INPUT')
    if hasattr(modifier, "properties"):
        getattr(modifier.properties.inputs, identifier).value = value
    else:
        modifier[identifier] = value
    modifier.id_data.update_tag()


class _Points(Builder):
    """Adds nodes that change points."""

    def vector(self, operation: str, *values):
        """A vector, or the number that the operation gives; SCALE takes a vector and a number."""
        if operation == 'SCALE':
            values = {"Vector": values[0], "Scale": values[1]}
        return self.first('ShaderNodeVectorMath', values, operation=operation)

    def mix(self, a, b, share):
        """The vector from a (share 0) to b (share 1)."""
        return self.vector('ADD', a, self.vector('SCALE', self.vector('SUBTRACT', b, a), share))

    def between(self, value, low, high):
        """0 up to low, 1 from high on, smooth between."""
        extent = self.math('MAXIMUM', self.math('SUBTRACT', high, low), 1e-6)
        ramp = self.math('DIVIDE', self.math('SUBTRACT', value, low), extent, clamp=True)
        return self.math('MULTIPLY', self.math('MULTIPLY', ramp, ramp), self.math('SUBTRACT', 3.0, self.math('MULTIPLY', ramp, 2.0)))

    def value(self, name: str):
        """An attribute of points."""
        return self.attribute(name, point_edits.ATTRIBUTES[name]).outputs[0]

    def set(self, geometry, name: str, value):
        """The geometry with an attribute of points."""
        return self.store(geometry, name, point_edits.ATTRIBUTES[name], value)

    def moved(self, geometry, offset):
        """The geometry with its points moved."""
        return self.node('GeometryNodeSetPosition', {"Geometry": geometry, "Offset": offset}).outputs[0]

    def noise(self, place, scale, w=0.0):
        """(a number 0..1, most of them between 0.35 and 0.65; a vector about 0) that change smoothly in space, and with w."""
        node = self.node('ShaderNodeTexNoise', {"Vector": place, "W": w, "Scale": scale, "Detail": 2.0}, noise_dimensions='4D')
        colour = self.vector('SUBTRACT', node.outputs["Color"], (0.5, 0.5, 0.5))
        return node.outputs[0], self.vector('SCALE', colour, 2.0)

    def random(self, low, high, seed=0):
        """A vector for each point, by its id."""
        return self.node('FunctionNodeRandomValue', {"Min": low, "Max": high, "Seed": seed}, data_type='FLOAT_VECTOR').outputs[0]


def _dissolve(b: _Points):
    noise, _ = b.noise(b.position(), b.given["Noise Scale"])
    spread = b.math('DIVIDE', b.math('SUBTRACT', noise, 0.35), 0.3, clamp=True)
    soft = b.math('MAXIMUM', b.given["Softness"], 1e-4)
    gone = b.math('DIVIDE', b.math('SUBTRACT', b.math('MULTIPLY', b.given["Amount"], b.math('ADD', 1.0, soft)), spread), soft, clamp=True)
    opacity = b.math('MULTIPLY', b.value(point_edits.OPACITY), b.math('SUBTRACT', 1.0, gone))
    geometry = b.set(b.given["Geometry"], point_edits.OPACITY, opacity)
    return b.moved(geometry, b.vector('SCALE', b.given["Drift"], gone))


def _wind(b: _Points):
    time = b.node('GeometryNodeInputSceneTime').outputs["Seconds"]
    box = b.node('GeometryNodeBoundBox', {"Geometry": b.given["Geometry"]})
    places = box.outputs["Min"], box.outputs["Max"], b.position()
    low, high, here = (b.node('ShaderNodeSeparateXYZ', (place,)).outputs["Z"] for place in places)
    height = b.math('DIVIDE', b.math('SUBTRACT', here, low), b.math('MAXIMUM', b.math('SUBTRACT', high, low), 1e-6), clamp=True)
    rooted = b.math('ADD', 1.0, b.math('MULTIPLY', b.given["Rooted"], b.math('SUBTRACT', height, 1.0)))
    strength = b.math('MULTIPLY', b.given["Strength"], rooted)
    gust, swirl = b.noise(b.position(), b.given["Noise Scale"], b.math('MULTIPLY', time, b.given["Speed"]))
    push = b.vector('SCALE', b.vector('NORMALIZE', b.given["Direction"]), gust)
    return b.moved(b.given["Geometry"], b.vector('SCALE', b.vector('ADD', push, b.vector('SCALE', swirl, b.given["Turbulence"])), strength))


def _scatter(b: _Points):
    way = b.random((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0), b.given["Seed"])
    far = b.math('MULTIPLY', b.given["Amount"], b.given["Distance"])
    fall = b.vector('SCALE', b.given["Pull"], b.math('MULTIPLY', b.given["Amount"], b.given["Amount"]))
    geometry = b.moved(b.given["Geometry"], b.vector('ADD', b.vector('SCALE', way, far), fall))
    smaller = b.math('SUBTRACT', 1.0, b.math('MULTIPLY', b.given["Amount"], b.given["Shrink"]))
    return b.set(geometry, point_edits.SCALE, b.vector('SCALE', b.value(point_edits.SCALE), smaller))


def _sweep(b: _Points):
    along = b.vector('DOT_PRODUCT', b.position(), b.vector('NORMALIZE', b.given["Direction"]))
    box = b.node('GeometryNodeAttributeStatistic', {"Geometry": b.given["Geometry"], "Attribute": along}, data_type='FLOAT', domain='POINT')
    low, extent = find_socket(box.outputs, "Min"), find_socket(box.outputs, "Range")
    at = b.math('DIVIDE', b.math('SUBTRACT', along, low), b.math('MAXIMUM', extent, 1e-6))
    width = b.math('MAXIMUM', b.given["Width"], 1e-4)
    gone = b.math('DIVIDE', b.math('SUBTRACT', b.math('MULTIPLY', b.given["Amount"], b.math('ADD', 1.0, width)), at), width, clamp=True)
    left = b.math('SUBTRACT', 1.0, gone)
    edge = b.math('MULTIPLY', b.math('MULTIPLY', gone, left), 4.0)
    colour = b.mix(b.value(point_edits.COLOR), b.given["Glow"], edge)
    geometry = b.set(b.given["Geometry"], point_edits.COLOR, colour)
    return b.set(geometry, point_edits.OPACITY, b.math('MULTIPLY', b.value(point_edits.OPACITY), left))


def _freeze(b: _Points):
    centre = b.node('GeometryNodeObjectInfo', {"Object": b.given["Centre"]}, transform_space='RELATIVE').outputs["Location"]
    far = b.vector('DISTANCE', b.value(point_edits.STILL), centre)
    end = b.math('ADD', b.given["Distance"], b.given["Width"])
    frozen = b.math('MULTIPLY', b.between(far, b.given["Distance"], end), b.given["Amount"])
    opacity = b.value(point_edits.OPACITY)
    change = b.math('MULTIPLY', b.math('SUBTRACT', b.value(point_edits.STILL_OPACITY), opacity), frozen)
    geometry = b.set(b.given["Geometry"], point_edits.OPACITY, b.math('ADD', opacity, change))
    return b.moved(geometry, b.vector('SCALE', b.vector('SUBTRACT', b.value(point_edits.STILL), b.position()), frozen))


@dataclass(frozen=True)
class Effect:
    """A node group: its name in the interface, what it does, how it is built, and its inputs.

    inputs  by name: the type of its socket ('Float', 'Vector', 'Int', 'Color', 'Object'), and what is set of it
    """

    label: str
    description: str
    build: Callable
    inputs: dict[str, tuple[str, dict]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Of the node group."""
        return f"Splat {self.label}"


def _amount(what: str):
    return 'Float', {"default_value": 0.5, "min_value": 0.0, "max_value": 1.0, "subtype": 'FACTOR', "description": what}


def _vector(what: str, *value: float):
    return 'Vector', {"default_value": value, "description": what}


def _number(what: str, value: float, low: float = 0.0, high: float = 1e4, **more):
    return 'Float', {"default_value": value, "min_value": low, "max_value": high, "description": what, **more}


EFFECTS = {
    'DISSOLVE': Effect("Dissolve", "Let the capture vanish in patches, which drift away", _dissolve, {
        "Amount": _amount("0: all is there; 1: all is gone. Key it"),
        "Softness": _number("How gradually each patch goes", 0.3, 0.0, 1.0, subtype='FACTOR'),
        "Noise Scale": _number("Size of the patches: larger numbers make smaller ones", 1.5),
        "Drift": _vector("Where what vanishes goes", 0.0, 0.0, 0.3)}),
    'WIND': Effect("Wind", "Move the capture with gusts of noise, its top more than its bottom", _wind, {
        "Strength": _number("How far points are moved at the most", 0.2, subtype='DISTANCE'),
        "Direction": _vector("Where the wind blows", 1.0, 0.0, 0.0),
        "Turbulence": _number("How much of it whirls around", 0.4, 0.0, 10.0),
        "Noise Scale": _number("Size of the gusts: larger numbers make smaller ones", 0.7),
        "Speed": _number("How fast gusts change", 0.8),
        "Rooted": _number("How much the bottom stays where it is", 1.0, 0.0, 1.0, subtype='FACTOR')}),
    'SCATTER': Effect("Scatter", "Burst the capture into single Gaussians, each on its own way", _scatter, {
        "Amount": _amount("0: nothing is moved. Key it"),
        "Distance": _number("How far Gaussians fly, along each axis at the most", 1.0, subtype='DISTANCE'),
        "Pull": _vector("Where all of them are drawn besides, such as down", 0.0, 0.0, -0.5),
        "Shrink": _number("How much smaller they become", 0.5, 0.0, 1.0, subtype='FACTOR'),
        "Seed": ('Int', {"default_value": 0, "description": "Other random ways"})}),
    'SWEEP': Effect("Sweep", "Let a front with a glowing edge go through the capture and take it away, or bring it", _sweep, {
        "Amount": _amount("How far the front has gone: 0: all is there; 1: all is gone. Key it, backwards to reveal"),
        "Direction": _vector("Where the front goes", 0.0, 0.0, 1.0),
        "Width": _number("Of the edge, as a share of the capture", 0.15, 0.0, 1.0, subtype='FACTOR'),
        "Glow": ('Color', {"default_value": (2.0, 0.7, 0.15, 1.0), "description": "Colour of the edge, scene linear"})}),
    'FREEZE': Effect("Freeze at a Distance", "Let only what is near an object move; all else stands as on the Freeze Frame", _freeze, {
        "Amount": _number("How much is held back", 1.0, 0.0, 1.0, subtype='FACTOR'),
        "Centre": ('Object', {"description": "What moves is around this object; none: around the capture's origin"}),
        "Distance": _number("Up to where everything moves", 1.0, subtype='DISTANCE'),
        "Width": _number("Over which distance it comes to a halt", 0.5, subtype='DISTANCE')}),
}


def group(key: str) -> bpy.types.NodeTree:
    """An effect's node group in this .blend; made where it is missing."""
    effect = EFFECTS[key]
    found = next((tree for tree in bpy.data.node_groups if tree.name == effect.name and tree.library is None), None)
    if found is None:
        found = build(effect)
        found.name = effect.name
    return found


def build(effect: Effect) -> bpy.types.NodeTree:
    """A new node group of an effect."""
    tree = bpy.data.node_groups.new(effect.name, 'GeometryNodeTree')
    tree.is_modifier = True
    tree.interface.new_socket("Geometry", in_out='OUTPUT', socket_type='NodeSocketGeometry')
    tree.interface.new_socket("Geometry", in_out='INPUT', socket_type='NodeSocketGeometry')
    for name, (kind, values) in effect.inputs.items():
        item = tree.interface.new_socket(name, in_out='INPUT', socket_type=f"NodeSocket{kind}")
        for setting, value in values.items():
            setattr(item, setting, value)
    builder = _Points(tree)
    builder.node('NodeGroupOutput', (effect.build(builder),))
    return tree


def add(obj: bpy.types.Object, key: str) -> bpy.types.Modifier:
    """Give a splat object an effect: a modifier before the one that makes its points visible.  All its Gaussians become points."""
    obj.fastgs.points = 'ALL'
    modifier = obj.modifiers.new(EFFECTS[key].label, 'NODES')
    modifier.node_group = group(key)
    ours = modifier_of(obj)
    if ours is not None:
        keep_last(ours)
        names = [m.name for m in obj.modifiers]
        obj.modifiers.move(names.index(ours.name), len(names) - 1)
    return modifier
