# SPDX-License-Identifier: GPL-3.0-or-later
"""fastgs check on a room whose faults are known: each is found in the camera that has it, and a good capture has none."""
from __future__ import annotations

import base64
import io
import json
import re

import numpy as np
import pytest
from filmed_room import texture, write_room
from PIL import Image, ImageFilter
from uneven_captures import write_uneven

from fastgs_blender import cli
from fastgs_blender.cameras.camera import Camera
from fastgs_blender.captures import open_capture
from fastgs_blender.checks import CHECKS, blur, check, page, timing
from fastgs_blender.checks.extrapolation import _few, _gaps
from fastgs_blender.checks.report import Section
from fastgs_blender.checks.samples import Inspection
from fastgs_blender.checks.space import Space
from fastgs_blender.util import rotations
from fastgs_blender.util.errors import FastGSError


def blurred(image, frame, sigma=2.0):
    shown = Image.fromarray(np.uint8(np.clip(image, 0, 1) * 255 + 0.5)).filter(ImageFilter.GaussianBlur(sigma))
    return np.asarray(shown) / 255


def turned(matrix, degrees=2.0):
    """The pose of a camera that was bumped after it was calibrated: turned about its own upward axis."""
    half = np.radians(degrees) / 2
    turn = np.eye(4)
    turn[:3, :3] = rotations.to_matrices(np.array([np.cos(half), 0, np.sin(half), 0]))
    return turn @ matrix


FAULTS = dict(change={1: blurred, 3: lambda image, frame: 0.7 * image, 6: lambda image, frame: image * (1, 0.88, 0.8)[frame]},
              calibrated={5: turned})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("checks")


@pytest.fixture(scope="module")
def good(folder):
    return check(write_room(folder / "good", 8, 2, detail=1))


@pytest.fixture(scope="module")
def faulty(folder):
    stages = []
    report = check(write_room(folder / "faulty", 8, 3, detail=1, **FAULTS), progress=lambda stage, share: stages.append((stage, share)))
    shares = [share for _, share in stages]
    assert shares == sorted(shares) and shares[-1] == 1 and {"reading pictures", "comparing pictures"} <= {stage for stage, _ in stages}
    return report


def told(report, name, grades=("wrong", "poor")):
    return {view: finding for section, finding in report.findings if section == name and finding.severity in grades
            for view in finding.views or [""]}


def test_a_good_capture_has_no_findings(good):
    assert not good.findings and not good.bad and "nothing was found" in good.verdict
    measures = good.values()["measures"]
    assert set(measures) == set(CHECKS) and measures["calibration"]["median_pixels"] < 0.5
    assert max(measures["sharpness"]["blur_pixels"].values()) < 1
    assert all(abs(value - 1) < 0.02 for value in measures["exposure"]["brightness"].values())


def test_a_bumped_camera_is_named_and_its_turn_measured(faulty):
    found = told(faulty, "calibration")
    assert set(found) == {"cam05"} and found["cam05"].severity == "wrong" and faulty.bad
    turn = faulty.sections["calibration"].measures["turned_degrees"]["cam05"]
    assert abs(turn - 2) < 0.1 and f"turned by {turn:.1f}" in found["cam05"].sentence
    assert faulty.findings[0][1].views == ("cam05",), "the worst comes first"


def test_a_blurred_camera_is_named(faulty):
    found = told(faulty, "sharpness")
    assert set(found) == {"cam01"}
    assert 1.3 < found["cam01"].figure[1] < 2.8


def test_a_darker_camera_and_a_changing_exposure_are_named(faulty):
    found = told(faulty, "exposure")
    assert set(found) == {"cam03", "cam06"} and abs(found["cam03"].figure[1] - 0.7) < 0.02
    assert re.search("cam03 .*1.1 stops darker.*0.7. times", found["cam03"].sentence), "stops are of light, and the factor of the pictures"
    assert "changes its exposure" in found["cam06"].sentence and 0.15 < found["cam06"].figure[1] < 0.25


@pytest.mark.slow
def test_all_cameras_changing_together_is_the_light(folder):
    lamp = {i: lambda image, frame: image * (1, 0.85, 0.95)[frame] for i in range(4)}
    report = check(write_room(folder / "lamp", 4, 3, spread=0.6, change=lamp, detail=1))
    (finding,) = {id(f): f for f in told(report, "exposure").values()}.values()
    assert "The light changes" in finding.sentence and len(finding.views) == 4


@pytest.mark.slow
def test_few_cameras_and_a_held_out_view_far_away(folder):
    """The check says beforehand that a view far from three cameras will be poor, and why, and shows what is seen from there."""
    report = check(write_room(folder / "few", 4, 3, spread=2.0, held_out=(3,), detail=1))
    found = told(report, "extrapolation")
    assert set(found) == {"", "cam03"} and "3 training cameras" in found[""].sentence
    assert re.search(r"stands [2-4]\d degrees from the nearest training camera, cam02, and \d+% of its picture", found["cam03"].sentence)
    held = next(p for p in report.sections["coverage"].pictures if p.pixels is not None)
    assert held.caption.startswith("cam03 (held out")
    assert report.sections["coverage"].measures["seen_by_fewer_than_3"]["cam03"] > 0.25


@pytest.mark.parametrize(("degrees", "beside", "gap", "words"), [
    (np.arange(0, 360, 30), (), 0, ""), ([*range(0, 120, 20), 180], [6], 80, "cam6"),
    ([0, 12, 70, 84, 160, 174, 250, 262], [2, 3, 4, 5, 6, 7], 76, "4 groups")])
def test_a_gap_between_groups_of_cameras_is_named(degrees, beside, gap, words):
    """Pairs of cameras around a stage: each has a neighbour, and between the pairs nothing is known."""
    apart = np.abs(np.subtract.outer(degrees, degrees))
    section = Section("View Extrapolation", "")
    _gaps(section, [f"cam{i}" for i in range(len(degrees))], np.minimum(apart, 360 - apart).astype(float))
    assert len(section.findings) == (1 if beside else 0)
    for finding in section.findings:
        assert finding.views == tuple(f"cam{i}" for i in beside) and finding.figure[1] == gap and words in finding.sentence


def test_cameras_that_agree_far_away_are_apart_for_what_is_near():
    """Two cameras 0.4 apart: 4 degrees for a wall 6 away, which most points lie on, and 22 for what stands 1 before them."""
    def camera(x):
        pose = np.eye(4)
        pose[0, 3] = -x
        return Camera(320, 180, 200.0, 200.0, 160.0, 90.0, pose)

    x, y = (values.ravel() for values in np.meshgrid(np.linspace(-6, 6, 40), np.linspace(-3, 3, 20)))
    wall = np.stack([x, y, np.full(len(x), 6.0)], 1)[np.abs(x) > 1.5]  # the middle is hidden by what is near
    near = np.stack([x / 20, y / 6, np.ones(len(x))], 1)[::5]
    space = Space({"a": camera(0.0), "b": camera(0.4)}, ["a", "b"], np.concatenate([wall, near]), np.zeros(3), (0.5, 8), "RDF")
    angles = space.apart("a")
    assert space.angle("a", "b") < 8
    assert 15 < angles[angles.shape[0] // 2, angles.shape[1] // 2] < 30
    section = Section("View Extrapolation", "")
    _few(section, space, ["a", "b"])
    (finding,) = section.findings
    assert finding.severity == "poor" and "2 training cameras" in finding.sentence
    assert 0.1 < section.measures["alone"]["a"] < 0.7 and abs(finding.figure[1] - np.mean(list(section.measures["alone"].values()))) < 0.002


def test_clocks_that_differ_are_found(tmp_path):
    late = write_uneven(tmp_path / "late", 48, 5, {"cam02": 3.0}, speed=1.5)
    section = timing.run(Inspection(open_capture(late)))
    assert [finding.views for finding in section.findings if finding.severity == "wrong"] == [("cam02",)]
    assert abs(section.measures["offsets_frames"]["cam02"] - 3) < 0.3
    (late / "sync.json").write_text(json.dumps({"format": "fast-gs sync", "version": 1, "offsets": {"cam02": 3.0}}))
    section = timing.run(Inspection(open_capture(late)))
    assert not section.findings, "what training knows already is no fault"


def test_clocks_without_poses_are_unsure(tmp_path):
    """Curves of motion are right to a frame: what they say of equal clocks is no figure."""
    made = write_uneven(tmp_path / "made", 48, 5, speed=1.5)
    (made / "cameras.json").unlink()
    section = timing.run(Inspection(open_capture(made)))
    assert set(section.columns["Clock"].values()) == {"unsure"} and {finding.severity for finding in section.findings} == {"note"}


@pytest.mark.parametrize("sigma", [0, 1, 2])
def test_blur_is_measured_in_pixels(sigma):
    image = blurred(texture(1), 0, sigma) if sigma else texture(1)
    assert abs(blur.blur_of(np.uint8(image * 255)) - sigma) < 0.5
    assert np.isnan(blur.blur_of(np.full((256, 256, 3), 90, np.uint8)))


def test_the_page_stands_alone(faulty, tmp_path):
    """Its pictures are inside, they can be read, and nothing is fetched."""
    paths = page.write(faulty, tmp_path / "out")
    text = paths[0].read_text("utf-8")
    assert not re.search(r'(?:src|href)="(?!data:)', text) and "<script" not in text
    images = re.findall(r"data:image/jpeg;base64,([^\"]+)", text)
    assert len(images) >= 16 and Image.open(io.BytesIO(base64.b64decode(images[0]))).size == (320, 240)
    for finding in (finding for _, finding in faulty.findings):
        assert finding.sentence.replace("'", "&#x27;") in text
    assert page.html(faulty) == page.html(faulty) and json.loads(paths[1].read_text("utf-8")) == json.loads(json.dumps(faulty.values()))


def test_names_from_files_do_no_harm(good, tmp_path):
    good.capture = "/a/<script>alert(1)</script>\x1b"
    assert "<script" not in page.html(good) and "\x1b" not in page.html(good) and "\x1b" not in good.text()


def test_captures_without_poses_and_with_missing_files(folder, tmp_path):
    """What cannot be known is said; missing files are told as training would refuse them."""
    made = write_room(tmp_path / "bare", 3, 2, spread=0.4, detail=1)
    (made / "cameras.json").unlink()
    (made / "cam01" / "0002.png").unlink()
    report = check(made)
    assert "where its cameras" in report.sections["coverage"].summary
    assert not [f for _, f in report.findings if f.severity == "wrong"]
    assert any("frames 1-1 " in f.sentence for _, f in report.findings)
    for image in made.rglob("*.png"):
        image.write_bytes(b"no picture")
    with pytest.raises(FastGSError, match="3 of .*3 pictures"):
        check(made)


def test_cameras_that_training_cannot_find_are_wrong(tmp_path, rng):
    """Pictures that have nothing in common: training would stop, so the check says why, and what to do."""
    for view in ("cam00", "cam01"):
        (tmp_path / view).mkdir()
        for frame in (1, 2):
            Image.fromarray(rng.integers(0, 256, (48, 64, 3), np.uint8)).save(tmp_path / view / f"{frame:04}.png")
    report = check(tmp_path)
    (finding,) = [finding for name, finding in report.findings if name == "calibration"]
    assert report.bad and finding.severity == "wrong" and "trained on" not in report.verdict
    assert "where its cameras" in finding.sentence and "docs/captures.md" in finding.advice


@pytest.mark.slow
def test_the_command(tmp_path, capsys):
    """The exit code tells, --json is the page's values, --status says how far the check is."""
    made = write_room(tmp_path / "made", 3, 2, spread=0.4, detail=1)
    flags = [str(made), "--out", str(tmp_path / "out"), "--quiet"]
    assert cli.main(["check", *flags]) == 0 and "check.html" in capsys.readouterr().out
    Image.new("RGB", (9, 9)).save(made / "cam01" / "0002.png")
    assert cli.main(["check", *flags, "--json", "--status", str(tmp_path / "status.json")]) == 1
    values = json.loads(capsys.readouterr().out)
    assert values["findings"][0]["severity"] == "wrong" and values["page"] == str(tmp_path / "out" / "check.html")
    assert 0 <= json.loads((tmp_path / "status.json").read_text())["share"] <= 1
    assert cli.main(["check", str(tmp_path / "none")]) == 2


def test_the_text_is_as_wide_as_a_terminal(faulty):
    lines = faulty.text().splitlines()
    assert max(map(len, lines[1:])) <= 80 and lines[lines.index("") + 1].startswith("wrong  What cam05 shows")
    assert "standard" in " ".join(lines[-4:]), "what training will need comes last"
