# SPDX-License-Identifier: GPL-3.0-or-later
"""References for the engine's pictures: cameras and colours computed without the engine's own code."""
import numpy as np


def look_at(eye, target, up=(0, 0, 1)):
    """World-to-camera [4, 4] in OpenCV's axes."""
    eye, target = np.asarray(eye, float), np.asarray(target, float)
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, -rotation @ eye
    return matrix


def blender_matrix(world_to_camera):
    """The matrix_world of the Blender camera that looks the same way (y up, looking along -z)."""
    pose = np.linalg.inv(world_to_camera)
    pose[:3, 1:3] *= -1
    return pose


def camera(fg, world_to_camera, width=64, height=48, lens=50.0, sensor=36.0, horizontal=True, shift=(0, 0), aspect=(1, 1),
           ortho_scale=None, near=0.1, window=None, far=1000.0):
    """The library's camera from the numbers in Blender's camera panel (defaults: Blender's).

    sensor      millimetres of the side that the sensor is fitted to; horizontal says which
    """
    tall = aspect[1] / aspect[0]  # height of a pixel in widths of a pixel
    side = width if horizontal else height * tall
    fx = side / ortho_scale if ortho_scale else lens / sensor * side
    return fg.Camera(width, height, fx=fx, fy=fx / tall, cx=width / 2 - shift[0] * side, cy=height / 2 + shift[1] * side / tall,
                     world_to_camera=world_to_camera, orthographic=bool(ortho_scale), near=near, window=window, far=far)


def linear(srgb):
    """The sRGB curve's decoding, for non-negative numbers."""
    srgb = np.asarray(srgb, float)
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def srgb(linear):
    """The sRGB curve's encoding, for non-negative numbers."""
    x = np.asarray(linear, float)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def combined(rgb, alpha, background=None):
    """What Combined should hold for a premultiplied sRGB picture."""
    weight = alpha[..., None]
    straight = linear(rgb / np.where(weight > 0, weight, 1))
    out = np.concatenate([straight * weight, weight], -1)
    if background is not None:
        out += (1 - weight) * np.array([*background, 1.0])
    return out


def assert_same_picture(actual, expected):
    """Equal but for splats whose alpha lies within rounding of the cut (a step of 1/255) at single pixels."""
    difference = np.abs(np.asarray(actual, float).reshape(expected.shape) - expected)
    assert difference.max() < 6e-3 and difference.mean() < 1e-5, (difference.max(), difference.mean())
