# SPDX-License-Identifier: GPL-3.0-or-later
"""The equations that shaders share: one text, which is WGSL and becomes GLSL."""
from __future__ import annotations

import re

import pytest

from fastgs_blender.kernels.equations import text

NAMES = sorted(file.stem for file in text.FOLDER.glob("*.wgsl"))
WGSL_ALONE = r"\b(?:fn|let|var|f32|i32|u32|vec[234][fiu]|mat\dx\df|select|array)\b|->|\{[A-Z]"

WGSL = """// Two numbers.
struct Pair {
    first: f32, // of them
    both: vec2f,
}

var<private> room: array<f32, 25>;

fn larger(a: vec3f, wide: bool) -> f32 {
    let most: f32 = max(a.x, a.y);
    var i: i32 = 0;
    if (wide && most > 1e-3) {
        return most;
    }
    let turned: mat3x3f = mat3x3f(a, a, a);
    return (turned * a).x;
}
"""
GLSL = """/* Two numbers. */
struct Pair {
    float first; /* of them */
    vec2 both;
};

float room[25];

float larger(vec3 a, bool wide) {
    float most = max(a.x, a.y);
    int i = 0;
    if (wide && most > 1e-3) {
        return most;
    }
    mat3 turned = mat3(a, a, a);
    return (turned * a).x;
}
"""


def test_only_declarations_and_types_change():
    assert text.to_glsl(WGSL) == GLSL


@pytest.mark.parametrize("name", NAMES)
def test_each_becomes_glsl_line_by_line(name):
    wgsl = text.read(text.FOLDER / f"{name}.wgsl").partition(text.BACKWARD)[0]
    code = re.sub(r"/\*.*?\*/", "", text.glsl(name))
    assert not re.search(WGSL_ALONE, code), re.search(WGSL_ALONE, code)
    assert len(text.glsl(name).splitlines()) == len(wgsl.splitlines())
    assert re.findall(r"fn (\w+)\(", wgsl) == re.findall(r"^\w+ (\w+)\(", code, re.MULTILINE)


def test_a_number_without_a_value_is_told():
    with pytest.raises(KeyError, match="NOBODYS"):
        text.filled("{NOBODYS}", text.CONSTANTS)


def test_lines_are_numbered_as_compilers_count_them():
    assert text.numbered("a\nb\n") == "   1  a\n   2  b\n"
