# SPDX-License-Identifier: GPL-3.0-or-later
"""Things that touch and move are told apart from two strokes, on all frames."""
from __future__ import annotations

import dataclasses
import warnings

import numpy as np
import pytest
import touching_scenes as scenes
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.kernels.cpu.walk import potential
from fastgs_blender.selecting.grow import connected, grow, unsure
from fastgs_blender.selecting.joins import Joins, joins
from fastgs_blender.selecting.neighbours import nearest
from fastgs_blender.selecting.spans import continued, spanned, untold


def made(name, count=3000):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the bake's, on how closely fast limbs are followed
        return scenes.made(name, count)


@pytest.mark.parametrize("name", ["ball and box", "cloths", "same colours", "lifted"])
def test_two_strokes_select_a_thing(name):
    """Seen in other views and on other frames than those of the strokes; then from the one stroke over the thing alone."""
    scene = made(name)
    yes, no = scenes.strokes(scene.model, scene)
    assert yes.sum() < 0.4 * scene.truth.sum()
    for against in (no, None):
        assert min(scenes.overlaps(scene.model, grow(scene.model, yes, against), scene, views=(3, 6), times=(0.1, 0.8))) >= 0.9


def test_the_border_is_moved_by_hand():
    """From a cloth to the one that lies on it, or not at all where nothing else is near; never to less than the strokes say."""
    scene = made("cloths")
    yes, no = scenes.strokes(scene.model, scene)
    for against in (no, None):
        less, found, more = (grow(scene.model, yes, against, reach) for reach in (-1, 0, 0.5))
        assert (less <= found).all() and np.mean(less == scene.truth) > 0.99
        assert (found <= more).all() and more.sum() > 1.5 * found.sum()


def test_another_reach_needs_no_new_potentials(monkeypatch):
    """Those of the latest strokes are kept; other strokes are not answered with them."""
    scene = made("cloths")
    model = scene.model.take(slice(None))
    yes, no = scenes.strokes(model, scene)
    asked = []
    monkeypatch.setattr("fastgs_blender.kernels.cpu.walk.potential", lambda *given: asked.append(given) or potential(*given))
    found = grow(model, yes, no)
    first = len(asked)
    grow(model, yes, no, 0.5)
    assert first and len(asked) == first
    other = grow(model, no, yes)
    assert len(asked) == 2 * first and (other != found).any()
    np.testing.assert_array_equal(grow(model, yes, no), found)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ball and box", "cloths", "lifted"])
def test_a_click_is_enough(name):
    """Three Gaussians, and they with a stroke over the rest; however many Gaussians the thing has."""
    for count in 3000, 9000:
        scene = made(name, count)
        yes, no = scenes.strokes(scene.model, scene)
        few = np.isin(np.arange(len(yes)), np.flatnonzero(yes & scene.truth)[:3])
        for against in (no, None):
            assert np.mean(grow(scene.model, few, against) == scene.truth) > 0.99


@pytest.mark.parametrize("clicked", [1, 6, 20])
def test_a_click_selects_a_whole_ball(clicked):
    """It rises over a disc that stands still, or there is nothing else; and its Gaussians are many."""
    rng, count = np.random.default_rng(4), 6000
    direction = rng.normal(size=(count, 3))
    ball = 0.6 * direction / np.linalg.norm(direction, axis=1, keepdims=True) + [0, 0, 0.95]
    disc = np.concatenate([rng.uniform(-1, 1, (count // 2, 2)), np.zeros((count // 2, 1))], 1)
    place, truth = np.concatenate([ball, disc]), np.arange(count + count // 2) < count
    motion = np.zeros((len(place), 4, 3))
    motion[truth, 0, 2] = 0.15
    colour = np.where(truth[:, None], [0.75, 0.2, 0.15], [0.4, 0.4, 0.45]) + rng.uniform(-0.03, 0.03, place.shape)
    model = fg.GaussianModel(position=place, motion=motion, rotation=rng.normal(size=(len(place), 4)), features=colour,
                             scale=np.full(place.shape, np.log(0.025)), opacity=np.full(len(place), 3.0), basis=fg.Fourier(2))
    near = np.argsort(np.linalg.norm(place - ball[0], axis=1))[:clicked]
    yes = np.isin(np.arange(len(place)), near)
    np.testing.assert_array_equal(grow(model, yes), truth)
    assert grow(model.take(np.flatnonzero(truth)), yes[truth]).all()


def test_what_stands_still_is_told_by_colour():
    scene = made("still life")
    yes, no = scenes.strokes(scene.model, scene)
    assert np.mean(grow(scene.model, yes, no) == scene.truth) > 0.99
    grey = dataclasses.replace(scene.model, features=np.full_like(scene.model.features, 0.5))
    assert np.mean(grow(grey, yes, no) == scene.truth) < 0.99


@pytest.mark.parametrize(("name", "share"), [("cloths", 0.99), ("still life", 0.95)])
def test_colours_tell_things_apart_though_neighbours_differ(name, share):
    """As in trained models, whose hidden Gaussians have any colour."""
    scene = made(name)
    yes, no = scenes.strokes(scene.model, scene)
    noise = 0.2 * np.random.default_rng(0).normal(size=scene.model.features.shape)
    model = dataclasses.replace(scene.model, features=(scene.model.features + noise).astype(np.float32))
    assert np.mean(grow(model, yes, no) == scene.truth) > share


def test_a_few_wrong_gaussians_of_a_stroke_are_outvoted():
    scene = made("ball and box")
    yes, no = scenes.strokes(scene.model, scene)
    yes |= np.isin(np.arange(len(yes)), np.random.default_rng(0).choice(np.flatnonzero(~scene.truth & ~no), 4, replace=False))
    assert np.mean(grow(scene.model, yes, no) == scene.truth) > 0.99


def test_what_the_rim_of_a_stroke_touched_is_not_meant():
    """Four Gaussians of the box below are in a stroke of forty, and no other stroke says what that box is."""
    scene = made("lifted")
    yes, no = scenes.strokes(scene.model, scene)
    box, below = np.flatnonzero(scene.truth), np.flatnonzero(scene.label == scene.names.index("base"))
    nearest_to_first = [rows[np.argsort(np.linalg.norm(scene.model.position[rows] - scene.model.position[rows[0]], axis=1))]
                        for rows in (box, below)]
    no[below], yes = False, yes & scene.truth
    yes[nearest_to_first[0][:40]] = yes[nearest_to_first[1][:4]] = True
    assert np.mean(grow(scene.model, yes, no) == scene.truth) > 0.99


def test_a_thing_ends_where_hardly_anything_joins_it():
    """Five Gaussians of the cloth behind are in the stroke, and pull the potential of that cloth up to the lowest border but one."""
    scene = made("cloths")
    yes, no = scenes.strokes(scene.model, scene)
    place, behind = scene.model.position, np.flatnonzero(~scene.truth)
    away = np.linalg.norm(place[behind, None] - place[scene.truth], axis=2).min(1)
    yes[behind[np.argsort(away, kind="stable")[:5]]] = True
    assert np.mean(grow(scene.model, yes, no & ~yes) == scene.truth) > 0.99


def test_what_goes_far_may_drift_apart_in_itself():
    """As in trained models: each Gaussian of a ball goes farther or less far than the others do."""
    scene = made("same colours")
    yes, no = scenes.strokes(scene.model, scene)
    off = 1 + 0.3 * np.random.default_rng(0).normal(size=(len(yes), 1, 1))
    model = dataclasses.replace(scene.model, motion=(scene.model.motion * off).astype(np.float32))
    assert np.mean(grow(model, yes, no) == scene.truth) > 0.98


def test_a_stroke_across_colours_means_a_thing_of_several():
    """From head to foot of a walker, whose arms have other colours and swing; along the torso alone, nothing of another colour is meant."""
    scene = made("walker")
    yes, no = scenes.strokes(scene.model, scene)
    assert np.mean(grow(scene.model, yes, no) == scene.truth) > 0.99
    torso = scene.label == scene.names.index("torso")
    found = grow(scene.model, yes & torso, no)
    assert found[torso].mean() > 0.99 and found[scene.label == scene.names.index("arm -1")].mean() < 0.01


RED, BLUE, HEAD = range(10), range(10, 20), range(20, 24)


def chain(parted=(), of=spanned, **changed) -> np.ndarray:
    """What spanned() makes of a thing of 20 in a chain of 40, of which a join at 23 and those of `parted` move; changed: its arguments."""
    rows = dict(yes=range(8, 12), no=[], thing=[*RED, *BLUE], may=[*RED, *BLUE, *HEAD], like=[*RED, *BLUE]) | changed
    first = np.arange(39, dtype=np.int32)
    drift, tint = (np.where(np.isin(first, at), most, 0.0) for at, most in (((23, *parted), 12.0), ((9, 19), 6.0)))
    found = Joins(np.stack([first, first + 1], 1), np.ones(39), drift, tint, 39)
    return of(found, **{name: np.isin(np.arange(40), list(those)) for name, those in rows.items()})


@pytest.mark.parametrize("changed", [
    dict(yes=range(6, 10)), dict(parted=[19]), dict(may=[*RED, *BLUE, *HEAD[1:]]), dict(thing=range(7, 13)), dict(yes=[])],
    ids=["a stroke of one colour", "what moves", "the other side's", "what is large", "no stroke"])
def test_what_hangs_on_a_thing_is_not_added(changed):
    """But the head is, for a stroke across colours, whether or not its thing moves in itself there."""
    for parted in [], [9]:
        assert np.flatnonzero(chain(parted)).tolist() == [*RED, *BLUE, *HEAD]
    assert np.flatnonzero(chain(**changed)).tolist() == [*changed.get("thing", [*RED, *BLUE])]


def test_a_stroke_that_touches_another_colour_of_the_thing_crosses_colours():
    """Of the thing as the cut found it, and not of what lies beside."""
    assert np.flatnonzero(chain(yes=range(11))).tolist() == [*RED, *BLUE, *HEAD]
    assert np.flatnonzero(chain(yes=range(11), thing=RED)).tolist() == [*RED]


def test_what_a_good_part_of_a_stroke_crosses_belongs_to_the_thing():
    """Though the cut left it out, as it does a foot on a denied floor; unless the other stroke goes over it too, it is large or moves."""
    for changed in {}, dict(may=[*RED, *HEAD]), dict(no=[*BLUE[4:6], *range(30, 40)]):
        assert np.flatnonzero(chain(**dict(thing=RED) | changed)).tolist() == [*RED, *BLUE, *HEAD]
    for changed in dict(no=BLUE[4:6]), dict(thing=range(6, 10)), dict(parted=[9]):
        assert set(BLUE).isdisjoint(np.flatnonzero(chain(**dict(thing=RED) | changed)))


def test_what_has_colours_of_the_stroke_is_found_first():
    """The rest of the thing, though a piece of other colours behind it belongs to the other side."""
    assert np.flatnonzero(chain(thing=range(16), may=[*RED, *BLUE, *HEAD[1:]])).tolist() == [*RED, *BLUE]


def doubts(parted=(), straight=False, **changed) -> list[list[int]]:
    """The parts of the same chain of which untold() says that no stroke tells, the largest first; a red stroke, and one beside.  Each ten
    of the chain lie beside the ten before, or all on a line."""
    k = np.arange(40)
    x = k if straight else np.where(k // 10 % 2, 9 - k % 10, k % 10)
    place = np.stack([x, 0 * k if straight else k // 10, 0 * k], 1).astype(float)

    def of(found, may, **rows):
        return untold(found, place, **rows)

    number = chain(parted, of, **dict(yes=range(6), no=range(30, 40), like=RED) | changed)
    return [np.flatnonzero(number == k).tolist() for k in range(1, number.max() + 1)]


def test_strokes_leave_parts_open():
    """Of another colour within the thing, and what hangs on it; not what a stroke goes over, moves, is large or has the stroke's colour."""
    assert doubts() == [[*BLUE], [*HEAD]]
    for changed in dict(yes=[*RED, *BLUE[4:8]]), dict(no=BLUE[:3]), dict(like=[*RED, *BLUE]):
        assert doubts(**changed) == [[*HEAD]]
    for changed in dict(yes=[*RED, *HEAD]), dict(no=HEAD), dict(parted=[19]), dict(thing=range(15, 20), like=range(20)):
        assert [*HEAD] not in doubts(**changed)
    assert doubts(thing=[]) == []


def test_no_part_of_a_thing_is_open_if_its_stroke_crosses_colours_or_it_goes_on_there():
    """What hangs on it still is."""
    whole = dict(thing=[*RED, *BLUE, *HEAD], like=[*RED, *BLUE])
    assert doubts(**whole) == [[*HEAD]] and doubts(straight=True, **whole) == []
    assert doubts(yes=[*range(6), *BLUE[:3]], **whole) == []
    assert doubts(straight=True) == [[*HEAD]]


def test_one_more_stroke_decides_a_part_that_is_unsure():
    """A walker, of whose torso alone a stroke knows: the legs hang on it.  A stroke over the whole walker leaves nothing open."""
    scene = made("walker")
    yes, no = scenes.strokes(scene.model, scene)
    assert not unsure(scene.model, yes, no, grow(scene.model, yes, no)).any()
    torso = yes & (scene.label == scene.names.index("torso"))
    part = unsure(scene.model, torso, no, grow(scene.model, torso, no))
    assert {scene.names[k] for k in set(scene.label[part > 0])} <= {"thigh 1", "thigh -1", "shin 1", "shin -1"} and part.max() == 2
    for number in 1, 2:
        few = np.isin(np.arange(len(part)), np.flatnonzero(part == number)[:6])
        for more, less, wanted in ((torso | few, no, True), (torso, no | few, False)):
            found = grow(scene.model, more, less)
            assert (found[part == number] == wanted).all() and not (unsure(scene.model, more, less, found) > 0)[few].any()


def sheet(beyond, drift=0.0, may=True) -> np.ndarray:
    """Of a sheet of 8 x 6, whose thing are the first 4 columns, the columns that continued() finds; the others lie at `beyond` [4]."""
    x = np.r_[np.arange(4.0), np.atleast_2d(beyond).T[:, 0]]
    place = np.stack([np.repeat(x, 6), np.tile(np.arange(6.0), 8), np.repeat([0.0, 0, 0, 0, *4 * [0.1]], 6)], 1)
    apart = np.linalg.norm(place[:, None] - place, axis=2)
    ends = np.argwhere(np.triu(apart < 1.5, 1)).astype(np.int32)
    thing = np.arange(48) < 24
    crosses = thing[ends[:, 0]] != thing[ends[:, 1]]
    found = Joins(ends, np.ones(len(ends)), np.where(crosses, drift, 0.0), np.where(crosses, 6.0, 0.0), len(ends))
    return np.flatnonzero(continued(found, place, thing, thing | may).reshape(8, 6).all(1))


def test_a_thing_goes_on_in_another_colour():
    """Not into what lies on it, moves against it or is the other side's."""
    assert sheet([4, 5, 6, 7]).tolist() == [*range(8)]
    for other in sheet([1, 2, 3, 4]), sheet([4, 5, 6, 7], drift=12.0), sheet([4, 5, 6, 7], may=False):
        assert other.tolist() == [*range(4)]


def test_a_stroke_over_one_colour_of_a_ball_is_enough():
    scene = made("ball and box", 6000)
    yes, no = scenes.strokes(scene.model, scene)
    east = scene.truth & (scene.model.position[:, 0] > scene.model.position[scene.truth, 0].mean())
    model = dataclasses.replace(scene.model, features=np.where(east[:, None], np.float32([0.1, 0.2, 0.8]), scene.model.features))
    for half in east, ~east:
        assert (yes & half).any() and np.mean(grow(model, yes & half, no) == scene.truth) > 0.99


def test_without_a_stroke_there_is_a_sentence():
    with pytest.raises(fg.FastGSError, match="stroke"):
        grow(random_model(np.random.default_rng(0), 30), np.zeros(30, bool))


def test_gaussians_that_lie_together_are_connected():
    """Two clumps, and one Gaussian between them that is far from both."""
    rng = np.random.default_rng(1)
    place = np.concatenate([rng.uniform(0, 1, (80, 3)), rng.uniform(0, 1, (80, 3)) + [4, 0, 0], [[2.5, 0.5, 0.5]]])
    model = fg.GaussianModel(place, np.tile([1.0, 0, 0, 0], (161, 1)), np.full((161, 3), -3.0), np.full(161, 3.0), np.full((161, 3), 0.5))
    some = np.arange(161) == 5
    np.testing.assert_array_equal(connected(model, some), np.arange(161) < 80)
    assert not connected(model, some ^ some).any() and (connected(model, some, 0.0) == some).all()
    assert joins(model) is joins(model)


@pytest.mark.parametrize("width", [3, 7])
def test_nearest_neighbours(rng, width):
    points = rng.normal(size=(2000, width))
    index, squared = nearest(points, 6)
    exact = np.sort(((points[:, None] - points[None]) ** 2).sum(-1), 1)[:, 1:7]
    np.testing.assert_allclose(squared, ((points[index] - points[:, None]) ** 2).sum(-1), rtol=1e-4)
    assert (np.diff(squared) >= 0).all() and all(len(set(row)) == 6 for row in index.tolist())
    assert np.mean(np.sqrt(squared / exact)) < 1.15
    assert nearest(points[:1], 6)[0].tolist() == [[-1] * 6]


def test_the_potential_solves_its_equations(rng):
    ends = np.unique(np.sort(rng.integers(0, 40, (150, 2)), 1), axis=0)
    ends = ends[ends[:, 0] < ends[:, 1]].astype(np.int32)
    weight, ground, source = rng.uniform(0.5, 1, len(ends)).astype(np.float32), rng.uniform(0.1, 1, 40), rng.normal(size=40)
    matrix = np.diag(ground)
    for (i, j), w in zip(ends, weight):
        matrix[[i, j], [i, j]] += w
        matrix[[i, j], [j, i]] -= w
    exact = np.linalg.solve(matrix, source)
    assert np.abs(potential(ends, weight, ground, source, rng.permutation(40)) - exact).max() < 0.03 * np.abs(exact).max()
    assert not potential(ends, weight, ground, 0 * source, rng.permutation(40)).any()
