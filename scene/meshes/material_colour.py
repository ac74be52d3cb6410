# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluates the colour of materials at places on a surface, without a renderer, as far as their nodes can be evaluated.

A renderer's textures that only it can evaluate (noise, geometry, light paths) end in Unreadable, and the material's viewport
colour takes their place.
"""
import bpy
import numpy as np

from ...fastgs_blender.rendering.colour import linear_to_srgb, srgb_to_linear
from .. import arrays
from .surface import Piece

NO_MATERIAL = (0.8, 0.8, 0.8, 1.0)
"""What Blender shows where there is no material, scene linear."""


class Unreadable(Exception):
    """A node that has no meaning without a renderer; the message is its name."""


class MaterialColours:
    """A function of places on the pieces' triangles: call it with triangles [N] and barycentric weights [N, 3].

    It returns sRGB colour and opacity [N, 4]; notes has a sentence for each material that could not be read wholly.
    """

    def __init__(self, pieces: list[Piece]):
        self._pieces = pieces
        self._starts = np.cumsum([0] + [len(p.triangles) for p in pieces])
        self._images: dict[str, np.ndarray] = {}
        self._notes: dict[str, str] = {}

    @property
    def notes(self) -> list[str]:
        return list(self._notes.values())

    def __call__(self, triangle: np.ndarray, weights: np.ndarray) -> np.ndarray:
        out = np.empty((len(triangle), 4))
        which = np.searchsorted(self._starts, triangle, side="right") - 1
        for number in np.unique(which):
            piece, rows = self._pieces[number], np.flatnonzero(which == number)
            local = triangle[rows] - self._starts[number]
            for slot in np.unique(piece.material[local]):
                chosen = piece.material[local] == slot
                places = Places(piece, local[chosen], weights[rows[chosen]], self._images)
                material = piece.materials[min(slot, len(piece.materials) - 1)] if piece.materials else None
                found = _once(_material(material, places, self._notes))
                out[rows[chosen]] = np.c_[linear_to_srgb(np.clip(found[:, :3], 0, 1)), found[:, 3:]]
        return out


def _once(values: np.ndarray) -> np.ndarray:
    """One row [1, C] of values that are the same everywhere (Places.constant); else the values [n, C]."""
    return values[:1] if values.strides[0] == 0 else values


def _beside(colour: np.ndarray, alpha: np.ndarray, count: int) -> np.ndarray:
    """Colours [n, 3] and opacities [n, 1] as [n, 4], the same everywhere where both are."""
    colour, alpha = _once(colour), _once(alpha)
    if len(colour) == len(alpha):
        joined = np.concatenate([colour, alpha], 1)
    else:
        joined = np.concatenate([np.broadcast_to(values, (count, values.shape[1])) for values in (colour, alpha)], 1)
    return np.broadcast_to(joined, (count, 4))


class Places:
    """Some triangles of a piece [n] and barycentric weights [n, 3] on them: what nodes ask for there."""

    def __init__(self, piece: Piece, triangle: np.ndarray, weights: np.ndarray, images: dict):
        self._piece, self._corners, self._weights, self._images = piece, piece.corners[triangle], weights, images

    def __len__(self):
        return len(self._weights)

    def constant(self, values) -> np.ndarray:
        """The same number or colour [n, C] everywhere."""
        return np.broadcast_to(np.atleast_1d(np.asarray(values, np.float64)), (len(self), np.size(values)))

    def uv(self, name: str = "") -> np.ndarray:
        """Coordinates [n, 2] of a UV map, by default of the one that renders."""
        values = self._piece.uv.get(name or self._piece.default_uv)
        return np.zeros((len(self), 2)) if values is None else self._blend(values)

    def attribute(self, name: str) -> np.ndarray:
        """A colour attribute or UV map [n, 4], black where there is none of that name."""
        if name in self._piece.colours or (not name and self._piece.colours):
            return self._blend(self._piece.colours.get(name) if name else next(iter(self._piece.colours.values())))
        if name in self._piece.uv:
            return np.c_[self.uv(name), np.zeros(len(self)), np.ones(len(self))]
        return self.constant((0, 0, 0, 1))

    def image(self, image) -> np.ndarray:
        """Pixels [h, w, 4] of an image, scene linear, the bottom row first."""
        if image.name_full not in self._images:
            self._images[image.name_full] = _pixels(image)
        return self._images[image.name_full]

    def _blend(self, corner_values):
        return np.einsum("nkc,nk->nc", corner_values[self._corners].astype(np.float64), self._weights)


def _pixels(image) -> np.ndarray:
    width, height = image.size
    if not (width and height and image.channels):
        raise Unreadable(f'image "{image.name}", which cannot be loaded,')
    values = arrays.pixels(image)
    if image.channels < 3:
        values = np.concatenate([values[..., :1]] * 3 + ([values[..., 1:]] if image.channels == 2 else []), -1)
    if values.shape[2] == 3:
        values = np.concatenate([values, np.ones((height, width, 1), np.float32)], -1)
    if not image.is_float and image.colorspace_settings.name == 'sRGB':  # of 8-bit images Blender gives the values in the file
        values[..., :3] = srgb_to_linear(values[..., :3])
    return values


def _material(material, places: Places, notes: dict) -> np.ndarray:
    if material is None:
        return places.constant(NO_MATERIAL)
    viewport = places.constant(material.diffuse_color)
    if material.node_tree is None or (bpy.app.version < (5, 0, 0) and not material.use_nodes):
        return viewport
    output = next((material.node_tree.get_output_node(target) for target in ('ALL', 'CYCLES', 'EEVEE')
                   if material.node_tree.get_output_node(target)), None)
    link = _link(output.inputs["Surface"]) if output else None
    if link is None:
        return viewport
    try:
        return _Reader(places).surface(link)
    except Unreadable as what:
        notes[material.name] = (f'The colour of material "{material.name}" depends on the {what} which only a renderer can evaluate: '
                                "its viewport colour was taken instead.")
        return viewport


def _link(socket):
    return next((x for x in socket.links if x.is_valid and not x.is_muted), None) if socket.is_linked else None


class _Reader:
    """Walks the nodes of one material backwards from its output."""

    def __init__(self, places: Places):
        self._places = places
        self._groups: list = []

    # Shaders: colour and opacity [n, 4]

    def surface(self, link) -> np.ndarray:
        node = link.from_node
        if node.type in ('REROUTE', 'GROUP', 'GROUP_INPUT'):
            return self._through(link, self.surface, lambda socket: self._places.constant((0, 0, 0, 1)))
        shader = getattr(self, "_shader_" + node.type.lower(), None)
        if shader:
            return shader(node)
        colour = node.inputs.get("Color")
        if colour is None:
            raise Unreadable(f'node "{node.name}"')
        return _beside(self.value(colour, 3), self._places.constant(1.0), len(self._places))

    def _shader_bsdf_principled(self, node):
        colour = self.value(node.inputs["Base Color"], 3)
        strength = self.value(node.inputs["Emission Strength"], 1)
        if _once(strength).any():
            colour = colour + strength * self.value(node.inputs["Emission Color"], 3)
        return _beside(colour, self.value(node.inputs["Alpha"], 1), len(self._places))

    def _shader_emission(self, node):
        return np.c_[self.value(node.inputs["Color"], 3) * self.value(node.inputs["Strength"], 1), np.ones(len(self._places))]

    def _shader_bsdf_transparent(self, node):
        return self._places.constant((0, 0, 0, 0))

    def _shader_mix_shader(self, node):
        factor = self.value(node.inputs[0], 1)
        first, second = (self._shader(socket) for socket in node.inputs[1:3])
        alpha = (1 - factor) * first[:, 3:] + factor * second[:, 3:]
        colour = (1 - factor) * first[:, 3:] * first[:, :3] + factor * second[:, 3:] * second[:, :3]
        return np.c_[colour / np.maximum(alpha, 1e-6), alpha]

    def _shader_add_shader(self, node):
        first, second = (self._shader(socket) for socket in node.inputs[:2])
        return np.c_[first[:, :3] + second[:, :3], np.maximum(first[:, 3:], second[:, 3:])]

    def _shader(self, socket):
        link = _link(socket)
        return self.surface(link) if link else self._places.constant((0, 0, 0, 0))

    # Values: [n, width]

    def value(self, socket, width: int) -> np.ndarray:
        """A socket's number or colour at every place; a number becomes grey, a colour its luminance, where the other is wanted."""
        link = _link(socket)
        if link is None:
            return _fit(self._places.constant(socket.default_value), width)
        return _fit(self._output(link), width)

    def _output(self, link):
        node = link.from_node
        if node.type in ('REROUTE', 'GROUP', 'GROUP_INPUT'):
            return self._through(link, self._output, lambda socket: self._places.constant(socket.default_value))
        reader = getattr(self, "_node_" + node.type.lower(), None)
        if reader is None:
            raise Unreadable(f'node "{node.name}"')
        return reader(node, link.from_socket)

    def _through(self, link, read, unlinked):
        """Follow a reroute, or go into or out of a node group."""
        node, socket = link.from_node, link.from_socket
        if node.type == 'REROUTE':
            return self._follow(node.inputs[0], read, unlinked)
        if node.type == 'GROUP':
            inside = node.node_tree and next((n for n in node.node_tree.nodes if n.type == 'GROUP_OUTPUT' and n.is_active_output), None)
            if not inside:
                raise Unreadable(f'node "{node.name}"')
            self._groups.append(node)
            try:
                return self._follow(_by_identifier(inside.inputs, socket), read, unlinked)
            finally:
                self._groups.pop()
        group = self._groups.pop()
        try:
            return self._follow(_by_identifier(group.inputs, socket), read, unlinked)
        finally:
            self._groups.append(group)

    def _follow(self, socket, read, unlinked):
        link = _link(socket)
        return read(link) if link else unlinked(socket)

    def _node_rgb(self, node, socket):
        return self._places.constant(socket.default_value)

    _node_value = _node_rgb

    def _node_vertex_color(self, node, socket):
        values = self._places.attribute(node.layer_name)
        return values[:, 3:] if socket.name == "Alpha" else values

    def _node_attribute(self, node, socket):
        if node.attribute_type != 'GEOMETRY':
            raise Unreadable(f'node "{node.name}"')
        values = self._places.attribute(node.attribute_name)
        return {"Alpha": values[:, 3:], "Fac": values[:, :3].mean(1, keepdims=True)}.get(socket.name, values)

    def _node_mix_rgb(self, node, socket):
        return self._mix(node, node.inputs[0], node.inputs[1], node.inputs[2], node.blend_type, node.use_clamp)

    def _node_mix(self, node, socket):
        if node.data_type != 'RGBA':
            raise Unreadable(f'node "{node.name}"')
        factor, a, b = (next(s for s in node.inputs if s.identifier == key) for key in ("Factor_Float", "A_Color", "B_Color"))
        return self._mix(node, factor, a, b, node.blend_type, node.clamp_result)

    def _mix(self, node, factor, a, b, kind, clamp):
        blends = {
            'MIX': lambda x, y: y, 'MULTIPLY': lambda x, y: x * y, 'ADD': lambda x, y: x + y, 'SUBTRACT': lambda x, y: x - y,
            'SCREEN': lambda x, y: 1 - (1 - x) * (1 - y), 'DARKEN': np.minimum, 'LIGHTEN': np.maximum,
            'DIFFERENCE': lambda x, y: np.abs(x - y),
        }
        if kind not in blends:
            raise Unreadable(f'node "{node.name}"')
        share = np.clip(self.value(factor, 1), 0, 1)
        x, y = self.value(a, 3), self.value(b, 3)
        mixed = (1 - share) * x + share * blends[kind](x, y)
        return np.clip(mixed, 0, 1) if clamp else mixed

    def _node_valtorgb(self, node, socket):
        where = np.clip(self.value(node.inputs[0], 1)[:, 0], 0, 1)
        table = np.array([node.color_ramp.evaluate(x) for x in np.linspace(0, 1, 257)])
        values = np.stack([np.interp(where, np.linspace(0, 1, 257), column) for column in table.T], -1)
        return values[:, 3:] if socket.name == "Alpha" else values

    def _node_invert(self, node, socket):
        share, colour = self.value(node.inputs[0], 1), self.value(node.inputs[1], 3)
        return (1 - share) * colour + share * (1 - colour)

    def _node_gamma(self, node, socket):
        return np.maximum(self.value(node.inputs[0], 3), 0) ** self.value(node.inputs[1], 1)

    def _node_tex_image(self, node, socket):
        if node.image is None:
            return self._places.constant((0, 0, 0, 1))
        values = _look_up(self._places.image(node.image), self._vector(node.inputs["Vector"]), node.extension,
                          node.interpolation == 'Closest')
        return values[:, 3:] if socket.name == "Alpha" else values

    def _vector(self, socket) -> np.ndarray:
        """Texture coordinates [n, 2]."""
        link = _link(socket)
        if link is None:
            return self._places.uv()
        node = link.from_node
        if node.type == 'UVMAP':
            return self._places.uv(node.uv_map)
        if node.type == 'TEX_COORD' and link.from_socket.name == "UV":
            return self._places.uv()
        if node.type == 'ATTRIBUTE' and node.attribute_type == 'GEOMETRY':
            return self._places.uv(node.attribute_name)
        if node.type == 'REROUTE':
            return self._vector(node.inputs[0])
        if node.type == 'MAPPING' and node.vector_type in ('POINT', 'TEXTURE') and not any(_link(s) for s in node.inputs[1:]):
            return _map(self._vector(node.inputs["Vector"]), node)
        raise Unreadable(f'node "{node.name}"')


def _fit(values, width):
    have = values.shape[1]
    if have == width or (have == 4 and width == 3):
        return values[:, :width]
    if have == 1:
        return np.repeat(values, width, 1)
    return values[:, :3] @ np.array([[0.2126], [0.7152], [0.0722]]) if width == 1 else np.c_[values, np.zeros(len(values))]


def _by_identifier(sockets, socket):
    return next(s for s in sockets if s.identifier == socket.identifier)


def _map(uv, node):
    """A Mapping node without connected inputs."""
    place, turn, size = (np.array(node.inputs[key].default_value) for key in ("Location", "Rotation", "Scale"))
    c, s = np.cos(turn[2]), np.sin(turn[2])
    if abs(turn[:2]).max() > 1e-6:
        raise Unreadable(f'node "{node.name}"')
    turn = np.array([[c, -s], [s, c]])
    if node.vector_type == 'POINT':
        return uv * size[:2] @ turn.T + place[:2]
    return (uv - place[:2]) @ turn / np.where(size[:2] == 0, 1, size[:2])


def _look_up(pixels, uv, extension, closest) -> np.ndarray:
    """Values [n, 4] of an image [h, w, 4] at coordinates [n, 2], bilinear or nearest."""
    height, width = pixels.shape[:2]
    place = uv * [width, height] - (0 if closest else 0.5)
    low = np.floor(place).astype(np.int64)
    share = place - low
    if closest:
        return _texel(pixels, low[:, 0], low[:, 1], extension)
    out = np.zeros((len(uv), 4))
    for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
        weight = np.abs(1 - dx - share[:, 0]) * np.abs(1 - dy - share[:, 1])
        out += weight[:, None] * _texel(pixels, low[:, 0] + dx, low[:, 1] + dy, extension)
    return out


def _texel(pixels, x, y, extension):
    height, width = pixels.shape[:2]
    if extension == 'REPEAT':
        return pixels[y % height, x % width]
    if extension == 'MIRROR':
        x, y = x % (2 * width), y % (2 * height)
        return pixels[np.where(y < height, y, 2 * height - 1 - y), np.where(x < width, x, 2 * width - 1 - x)]
    values = pixels[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
    if extension == 'CLIP':
        values = np.where(((x >= 0) & (x < width) & (y >= 0) & (y < height))[:, None], values, 0)
    return values
