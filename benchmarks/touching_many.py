# SPDX-License-Identifier: GPL-3.0-or-later
"""Thirty scenes of things that touch, most of which move, for benchmarks/selecting.py --many."""
from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import touching_shapes as shapes
from touching_shapes import PLANE, TURN, T, Thing, block, egg, grid, ground, limb, path, rolling, scenes, sheet

Things = dict[str, Thing]
Wanted = list[tuple[str, ...]]
"""The things of a scene that strokes are drawn for, one after the other; of several names, that are one together."""


def alone(*names: str) -> Wanted:
    """Each for itself."""
    return [(name,) for name in names]


def of_tests(name: str) -> Callable[[], tuple[Things, Wanted]]:
    """A scene of tests/library/touching_scenes.py."""
    def make():
        things, wanted = scenes.SCENES[name]()
        return things, [wanted]
    return make


def cloths():
    """The two cloths of the tests, of which each is wanted."""
    return scenes.SCENES["cloths"]()[0], alone("front", "back")


# Stiff things


def balls(colours, floor):
    """A ball rolls into a row of three, and the last of them rolls on."""
    radius = 0.17
    come = np.where(T < 0.5, T / 0.5, 1) * (0.85 - 2 * radius)
    leave = np.where(T > 0.5, (T - 0.5) / 0.5, 0) * 0.4
    things = {"floor": ground(floor)}
    for k, (x, way) in enumerate(zip((-0.85, 0.0, 2 * radius, 4 * radius), (come, 0 * T, 0 * T, leave), strict=True)):
        things[f"ball{k}"] = rolling(radius, way / radius, path(x + way - 0.2, 0.05 * k, radius), colours[k], 0.1)
    return things


def balls_in_colours():
    """Four colours on a green floor."""
    colours = (0.8, 0.2, 0.2), (0.85, 0.75, 0.2), (0.2, 0.3, 0.8), (0.9, 0.9, 0.9)
    return balls(colours, (0.15, 0.4, 0.25)), alone("ball0", "ball1", "ball3")


def balls_alike():
    """All in the colour of the floor."""
    return balls([(0.5, 0.45, 0.4)] * 4, (0.5, 0.45, 0.4)), alone("ball0", "ball3")


def tower():
    """Four boxes stand on each other and slide, the upper ones further."""
    sway = np.sin(TURN * T)
    slide = 0 * T, 0.05 * sway, 0.12 * sway, 0.25 * T + 0.12 * sway
    colours = (0.7, 0.3, 0.2), (0.3, 0.6, 0.3), (0.3, 0.35, 0.7), (0.8, 0.7, 0.3)
    things = {"floor": ground()}
    for k in range(4):
        things[f"box{k}"] = block((-0.2, -0.2, 0.25 * k), (0.2, 0.2, 0.25 * k + 0.25), colours[k], 0.04, path(slide[k], 0, 0))
    return things, alone("box1", "box2", "box3")


def tower_alike():
    """The same in nearly one colour."""
    things, wanted = tower()
    for k in range(4):
        things[f"box{k}"] = dataclasses.replace(things[f"box{k}"], colour=(0.5 + 0.02 * k, 0.4 + 0.015 * k, 0.3))
    return things, wanted


def tray():
    """A tray carries a cup and an apple."""
    way = path(0.35 * np.sin(TURN * T), 0.1 * np.cos(TURN * T), 0.4 + 0.1 * np.sin(2 * TURN * T))
    return {"floor": ground(), "tray": block((-0.45, -0.3, 0), (0.45, 0.3, 0.04), (0.55, 0.4, 0.25), way=way, cells=8),
            "cup": egg((0.13, 0.13, 0.18), (-0.2, 0, 0.2), (0.85, 0.85, 0.8), way=way),
            "apple": egg(0.12, (0.1, 0.05, 0.16), (0.75, 0.2, 0.15), way=way)}, alone("cup", "apple", "tray")


def gears():
    """Two gears turn each other before a wall."""
    things = {"wall": block((-1, 0.07, 0), (1, 0.12, 1.1), (0.4, 0.42, 0.45), cells=8)}
    points, triangles = shapes.gear(12, 0.35)
    for name, x, angle, colour in (("left", -0.36, np.pi * T, (0.7, 0.55, 0.2)),
                                   ("right", 0.36, np.pi / 12 - np.pi * T, (0.6, 0.6, 0.62))):
        upright = scenes.turning(points, angle, 2)[..., [0, 2, 1]] * [1, -1, 1]
        things[name] = Thing(upright + [x, 0, 0.55], triangles[:, ::-1], colour, 0.06)
    return things, alone("left", "right")


def chequered():
    """A ball rolls up to a box on a floor, each chequered."""
    radius, way = 0.28, 0.35 * (1 - np.cos(np.pi * T))
    red, white, blue, yellow, black = (0.85, 0.2, 0.2), (0.95, 0.95, 0.9), (0.2, 0.3, 0.8), (0.9, 0.8, 0.2), (0.15,) * 3
    return {"floor": ground(texture=shapes.checks((0.9,) * 3, black, 4)),
            "ball": rolling(radius, way / radius, path(way - 0.6, 0, radius), red, texture=shapes.checks(red, white, 6)),
            "cube": block((0, -0.25, 0), (0.5, 0.25, 0.5), blue, way=path(0.38, 0, 0), texture=shapes.checks(blue, yellow, 5)),
            }, alone("ball", "cube")


def two_halves():
    """Two balls roll, each white and of another colour."""
    radius, way = 0.25, 0.4 * T
    white, red, blue = (0.9,) * 3, (0.8, 0.1, 0.1), (0.1, 0.2, 0.7)
    return {"floor": ground((0.5, 0.5, 0.5)),
            "ball": rolling(radius, way / radius, path(way - 0.5, 0, radius), white, texture=shapes.halves(white, red, 2, radius)),
            "other": rolling(radius, 0.5 * way / radius, path(0.12 + 0.7 * way, 0.1, radius), white,
                             texture=shapes.halves(white, blue, 1, 0.1))}, alone("ball", "other")


def rings():
    """Two rings hang in each other and turn."""
    points, triangles = shapes.ring(0.3, 0.07)
    one = scenes.turning(points, 0.4 * TURN * T, 0) + path(-0.18, 0, 0.6)[:, None]
    other = scenes.turning(points[:, [0, 2, 1]], 0.3 * TURN * T, 2) + path(0.16 + 0.03 * np.sin(TURN * T), 0, 0.6)[:, None]
    return {"floor": ground(), "ring a": Thing(one, triangles, (0.8, 0.6, 0.2)),
            "ring b": Thing(other, triangles[:, ::-1], (0.6, 0.6, 0.65))}, alone("ring a", "ring b")


def car():
    """A car with turning wheels drives; it is wanted as one."""
    x = T - 0.5
    things = {"road": ground((0.3, 0.3, 0.32), 0.05),
              "body": block((-0.35, -0.2, 0.12), (0.35, 0.2, 0.3), (0.75, 0.15, 0.15), way=path(x, 0, 0), cells=6, shaded=True),
              "cabin": block((-0.2, -0.17, 0.3), (0.15, 0.17, 0.45), (0.5, 0.6, 0.7), way=path(x, 0, 0), cells=5, shaded=True)}
    for k, (along, aside) in enumerate(((-0.22, -0.2), (0.22, -0.2), (-0.22, 0.2), (0.22, 0.2))):
        things[f"wheel{k}"] = rolling((0.12, 0.05, 0.12), x / 0.12, path(x + along, aside, 0.12), (0.1, 0.1, 0.1), 0.08)
    return things, [tuple(name for name in things if name != "road")]


def crates():
    """Crates ride on a belt.  Nothing tells the first two apart, so only the third is wanted."""
    way, dark, light = path(0.6 * T, 0, 0), (0.25, 0.25, 0.25), (0.32, 0.32, 0.3)
    points, triangles = grid(16)
    belt = scenes.moved((points - PLANE) * [2.6, 0.7, 1] + [-0.3, 0, 0.1], way)
    things = {"belt": Thing(belt, triangles, dark, texture=shapes.stripes(dark, light, 5)), "floor": ground((0.5, 0.5, 0.48))}
    for k, colour in enumerate(((0.7, 0.5, 0.3), (0.65, 0.5, 0.35), (0.3, 0.5, 0.7))):
        things[f"crate{k}"] = block((-0.13, -0.13, 0.1), (0.13, 0.13, 0.3 + 0.05 * k), colour, 0.04, way + [0.27 * k - 0.7, 0, 0],
                                    shaded=True)
    return things, alone("crate2")


def pendulums():
    """Three balls hang from a beam by rods; the outer ones swing away and back."""
    swing = 0.5 * np.sin(TURN * T)
    ball, faces = shapes.sphere(18)
    things = {"floor": ground()}
    for k, angle in enumerate((np.minimum(swing, 0), 0 * T, np.maximum(swing, 0))):
        top, way = np.array([0.24 * (k - 1), 0, 1.2]), path(np.sin(angle), 0, -np.cos(angle))
        line = top + 0.65 * way[:, None] * np.linspace(0, 1, 16)[:, None]
        rod, triangles = shapes.tube(line, 0.02, 8)
        points = np.concatenate([rod, scenes.moved(ball * 0.12, top + 0.75 * way)], 1)
        things[f"p{k}"] = Thing(points, np.concatenate([triangles, faces + rod.shape[1]]), (0.6 + 0.1 * k, 0.5, 0.4 - 0.1 * k))
    things["beam"] = block((-0.5, -0.04, 1.2), (0.5, 0.04, 1.28), (0.4, 0.3, 0.2))
    return things, alone("p0", "p1", "p2")


def tumble():
    """Two boxes roll over their edges, away from each other."""
    angle = 0.25 * TURN * T
    points, triangles = scenes.box((-0.2, -0.2, -0.2), (0.2, 0.2, 0.2))
    height = 0.2 * (np.abs(np.cos(angle)) + np.abs(np.sin(angle)))
    things = {"floor": ground((0.42, 0.4, 0.45))}
    for k, (side, colour) in enumerate(((-1, (0.7, 0.3, 0.25)), (1, (0.3, 0.5, 0.35)))):
        turned = scenes.turning(points, side * angle, 1) + path(side * (0.24 + 0.25 * T), 0.05 * side, height)[:, None]
        things[f"cube{k}"] = Thing(turned, triangles, colour, shaded=True)
    return things, alone("cube0", "cube1")


def planets():
    """Two balls go around a third, each turning."""
    things = {"floor": ground((0.2, 0.2, 0.25))}
    for k, (radius, far, laps, colour) in enumerate(((0.25, 0, 0, (0.9, 0.7, 0.2)), (0.13, 0.37, 1, (0.3, 0.5, 0.8)),
                                                     (0.1, 0.6, 0.6, (0.7, 0.3, 0.2)))):
        angle = TURN * T * laps - 1.5
        things[f"s{k}"] = rolling(radius, TURN * T, path(far * np.cos(angle), far * np.sin(angle), 0.5), colour, 0.08, axis=2)
    return things, alone("s0", "s1", "s2")


# Soft things


def draped():
    """A cloth over a bump that goes along, with a ball that rolls beside it."""
    x = 0.8 * T - 0.4

    def hang(u, v, t):
        place = np.stack([1.6 * (u - 0.5), 1.2 * (v - 0.5)], 1)
        away = np.hypot(place[:, 0] - (0.8 * t - 0.4), place[:, 1])
        return np.c_[place, 0.02 + 0.5 * np.exp(-((away / 0.3) ** 4))]

    return {"floor": ground((0.4, 0.4, 0.4)), "cloth": sheet(hang, 24, (0.6, 0.2, 0.25), 0.06),
            "ball": rolling(0.2, (x + 0.4) / 0.2, path(x, -0.8, 0.2), (0.2, 0.4, 0.7))}, alone("cloth", "ball")


def snake():
    """A snake crawls past a stone."""
    s = np.linspace(0, 1, 40)
    line = np.stack([np.stack([1.2 * s + 0.4 * t - 0.8, 0.15 * np.sin(1.5 * TURN * (s - t)), 0.06 + 0 * s], 1) for t in T])
    points, triangles = shapes.tube(line, 0.06 * np.sqrt(np.clip(1 - (2 * s - 1) ** 6, 0.02, 1)))
    return {"floor": ground((0.5, 0.42, 0.3), 0.08), "snake": Thing(points, triangles, (0.3, 0.5, 0.25), 0.1),
            "stone": egg((0.2, 0.15, 0.15), (0.1, 0.38, 0.1), (0.5, 0.5, 0.5))}, alone("snake")


def flag():
    """A flag of two colours waves on a pole."""
    def wave(u, v, t):
        across = 0.14 * u * np.sin(TURN * (1.3 * u - 2 * t))
        return np.stack([0.04 + 0.9 * u, across, 0.75 + 0.5 * v + 0.04 * u * np.sin(TURN * (u - t))], 1)

    pole, triangles = shapes.tube(scenes.still(np.linspace(0, 1, 30)[:, None] * [0, 0, 1.35]), 0.04)
    white, red = (0.9,) * 3, (0.8, 0.15, 0.15)
    return {"floor": ground((0.3, 0.45, 0.25)), "pole": Thing(pole, triangles, (0.6, 0.6, 0.62)),
            "flag": sheet(wave, 20, red, texture=shapes.halves(white, red, 2, 1.0))}, alone("flag", "pole")


def jelly():
    """Two cubes hop and are squeezed as they land."""
    points, triangles = scenes.box((-0.25, -0.25, 0), (0.25, 0.25, 0.5), 6)
    things = {"floor": ground((0.35, 0.35, 0.4))}
    for k, (x, colour) in enumerate(((-0.27, (0.3, 0.65, 0.4)), (0.27, (0.65, 0.35, 0.55)))):
        high = 0.8 + 0.2 * np.abs(np.cos(TURN * T + k))
        size = np.stack([high**-0.5, high**-0.5, high], 1)[:, None]
        jumps = path(x, 0, 0.25 * np.abs(np.sin(TURN * T + k)))[:, None]
        things[f"jelly{k}"] = Thing(points * size + jumps, triangles, colour, shaded=True)
    return things, alone("jelly0", "jelly1")


def book():
    """Two pages of a book are turned."""
    things = {"table": ground((0.4, 0.28, 0.2))}
    for k, (start, colour) in enumerate(((0.0, (0.9, 0.88, 0.8)), (0.35, (0.85, 0.8, 0.7)))):
        def leaf(u, v, t, k=k, start=start):
            angle = np.pi * np.clip((t - start) / 0.6, 0.02, 0.98)
            bent = angle + 0.4 * np.sin(angle) * (u - 0.5)
            return np.stack([0.5 * u * np.cos(bent), 0.7 * (v - 0.5), 0.06 + 0.012 * k + 0.5 * u * np.sin(bent)], 1)
        things[f"page{k}"] = sheet(leaf, 16, colour, 0.03)
    things["cover"] = block((-0.52, -0.37, 0), (0.52, 0.37, 0.05), (0.5, 0.15, 0.15), cells=6)
    return things, alone("page0", "page1", "cover")


def curtains():
    """Two curtains are drawn together before a wall."""
    things = {}
    for k, (side, colour) in enumerate(((-1, (0.55, 0.3, 0.3)), (1, (0.5, 0.32, 0.3)))):
        def hang(u, v, t, side=side):
            open_ = 0.75 + 0.25 * np.cos(TURN * t)
            return np.stack([side * (0.84 - 0.84 * open_ * u), 0.06 * np.sin(14 * u + TURN * t), 0.1 + v], 1)
        things[f"curtain{k}"] = sheet(hang, 20, colour, 0.04)
    things["wall"] = block((-1, 0.12, 0), (1, 0.16, 1.2), (0.6, 0.6, 0.55), cells=8)
    things["floor"] = ground((0.35, 0.3, 0.28))
    return things, alone("curtain0", "curtain1")


def boat():
    """A boat rides on waves; it is wanted as one, and its sail alone."""
    def height(x, y, t):
        return 0.07 * np.sin(3 * x - TURN * t) + 0.04 * np.sin(4 * y + TURN * t)

    def sea(u, v, t):
        x, y = 2.2 * (u - 0.5), 2.2 * (v - 0.5)
        return np.stack([x, y, height(x, y, t)], 1)

    x = 0.1 * np.sin(TURN * T)
    way = path(x, 0, height(x, 0, T) + 0.05)
    points, triangles = grid(10)
    sail = np.stack([0.03 + 0.35 * points[:, 0], 0.05 * np.sin(np.pi * points[:, 0]), 0.2 + 0.5 * points[:, 1]], 1)
    return {"sea": sheet(sea, 26, (0.2, 0.35, 0.5), 0.06), "hull": egg((0.4, 0.16, 0.14), (0, 0, 0), (0.5, 0.3, 0.2), way=way),
            "mast": block((-0.02, -0.02, 0.1), (0.02, 0.02, 0.7), (0.45, 0.3, 0.2), way=way, cells=5),
            "sail": Thing(scenes.moved(sail, way), triangles, (0.9, 0.88, 0.8))}, [("hull", "mast", "sail"), ("sail",)]


# Things with limbs


def arm_and_cube():
    """A robot's arm swings a cube."""
    upper = 0.5 * np.sin(TURN * T)
    fore = upper + 1.2 - 0.4 * np.sin(TURN * T + 0.8)
    shoulder, orange = path(-0.5, 0, 0.1), (0.85, 0.5, 0.15)
    elbow = shoulder + 0.5 * path(np.sin(upper), 0, np.cos(upper))
    hand = elbow + 0.5 * path(np.sin(fore), 0, np.cos(fore))
    return {"floor": ground(), "base": block((-0.65, -0.15, 0), (-0.35, 0.15, 0.12), (0.3, 0.3, 0.35)),
            "upper": limb(shoulder, elbow, 0.08, orange), "fore": limb(elbow, hand, 0.07, orange),
            "cube": block((-0.11, -0.11, -0.22), (0.11, 0.11, 0), (0.25, 0.45, 0.7), way=hand)}, [("cube",), ("upper", "fore")]


def two_people():
    """Two walkers pass each other closely."""
    walker, wanted = scenes.SCENES["walker"]()
    things = {"floor": walker["floor"]}
    for name in wanted:
        thing = walker[name]
        red, green, blue = thing.colour
        things["a " + name] = dataclasses.replace(thing, points=thing.points + [0, -0.22, 0])
        colour = 0.9 * blue, 0.9 * red, 0.9 * green
        things["b " + name] = Thing(thing.points * [-1, 1, 1] + [0, 0.22, 0], thing.triangles[:, ::-1], colour)
    return things, [tuple(f"{who} {name}" for name in wanted) for who in "ab"]


def fingers():
    """Four fingers close around a ball and lift it."""
    lift, skin = 0.3 * np.clip((T - 0.4) / 0.6, 0, 1), (0.75, 0.55, 0.45)
    near = 0.21 + 0.25 * np.clip((0.35 - T) / 0.35, 0, 1)
    things = {"table": ground((0.5, 0.4, 0.3)), "ball": egg(0.2, (0, 0, 0.2), (0.8, 0.75, 0.3), way=path(0, 0, lift))}
    for k in range(4):
        x, y = np.cos(0.25 * TURN * k + 0.4), np.sin(0.25 * TURN * k + 0.4)
        things[f"finger{k}"] = limb(path(near * x, near * y, 0.17 + lift), path(0.2 * x, 0.2 * y, 0.75 + lift), 0.05, skin)
    things["palm"] = egg((0.28, 0.28, 0.1), (0, 0, 0.78), skin, way=path(0, 0, lift))
    return things, [("ball",), ("palm", "finger0", "finger1", "finger2", "finger3")]


SCENES: dict[str, Callable[[], tuple[Things, Wanted]]] = {
    "balls in colours": balls_in_colours, "balls alike": balls_alike, "tower": tower, "tower alike": tower_alike, "draped": draped,
    "tray": tray, "snake": snake, "gears": gears, "chequered": chequered, "flag": flag, "jelly": jelly, "rings": rings, "book": book,
    "car": car, "arm and cube": arm_and_cube, "two people": two_people, "fingers": fingers, "two halves": two_halves,
    "pendulums": pendulums, "crates": crates, "curtains": curtains, "cloths": cloths, "tumble": tumble, "boat": boat, "planets": planets,
    **{name: of_tests(name) for name in ("walker", "ball and box", "same colours", "still life", "lifted")}}
