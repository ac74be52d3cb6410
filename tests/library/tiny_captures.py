# SPDX-License-Identifier: GPL-3.0-or-later
"""The smallest capture of each layout, as files in a folder: what tests damage."""
from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
from PIL import Image

from fastgs_blender.util import rotations

WIDTH, HEIGHT, FOCAL = 32, 24, 30.0
VIEWS = ("cam00", "cam01")
FRAMES = 2


def pose(i: int) -> np.ndarray:
    """World-to-camera [4, 4] of the i-th camera."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotations.to_matrices(rotations.unit(np.array([1.0, 0.02, 0.1 * i, 0.01])))
    matrix[:3, 3] = 0.3 * i, 0.1, 3.0
    return matrix


def opengl(i: int) -> list:
    """Camera-to-world of the i-th camera, in OpenGL's axes, as lists."""
    return (np.linalg.inv(pose(i)) @ np.diag([1.0, -1, -1, 1])).tolist()


def picture(path: Path, i: int, frame: int) -> None:
    """A picture of a few colours."""
    path.parent.mkdir(parents=True, exist_ok=True)
    x, y = np.arange(WIDTH) // 4, np.arange(HEIGHT)[:, None] // 4
    Image.fromarray(np.uint8(np.stack([x * 20 + 0 * y, y * 30 + 0 * x, 0 * x * y + 40 * i + 90 * frame], -1))).save(path)


def pictures(folder: Path, name: str = "{view}/{frame:04}.png") -> None:
    for i, view in enumerate(VIEWS):
        for frame in range(FRAMES):
            picture(folder / name.format(view=view, frame=frame + 1), i, frame)


def video(path: Path, frames: int = 6, codec: str = "libx264", **options) -> None:
    """A short video."""
    import av

    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25, options=options)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuvj420p" if codec == "mjpeg" else "yuv420p"
        for frame in range(frames):
            grey = np.full((HEIGHT, WIDTH, 3), 40 + 9 * frame, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(grey, format="rgb24")))
        container.mux(stream.encode(None))


def points(path: Path, ascii_: bool = False) -> None:
    """A points.ply with colours and times."""
    table = np.zeros(5, [(n, "<f4") for n in "xyz"] + [(n, "u1") for n in ("red", "green", "blue")] + [("t", "<f4")])
    table["x"], table["red"] = np.arange(5), 40
    kinds = "".join(f"property {'uchar' if table.dtype[n] == np.uint8 else 'float'} {n}\n" for n in table.dtype.names)
    head = f"ply\nformat {'ascii' if ascii_ else 'binary_little_endian'} 1.0\nelement vertex 5\n{kinds}end_header\n".encode()
    rows = "".join(" ".join(str(v) for v in row) + "\n" for row in table.tolist()).encode() if ascii_ else table.tobytes()
    path.write_bytes(head + rows)


def fastgs(folder: Path) -> None:
    pictures(folder)
    pictures(folder, "masks/{view}/{frame:04}.png")
    points(folder / "points.ply")
    camera = dict(width=WIDTH, height=HEIGHT, fx=FOCAL, fy=FOCAL, cx=16.0, cy=12.0)
    cameras = [dict(name="cam00", **camera, world_to_camera=pose(0).tolist(), distortion={"model": "opencv", "k1": -0.1, "p1": 0.01}),
               dict(name="cam01", **camera, world_to_camera=[pose(1).tolist(), pose(2).tolist()],
                    distortion={"model": "fisheye", "k1": 0.1})]
    (folder / "cameras.json").write_text(json.dumps({
        "format": "fast-gs capture", "version": 1, "fps": 24, "start_frame": 1, "frame_count": FRAMES, "axes": "RDF", "masks": "valid",
        "colour": "auto", "held_out": ["cam01"], "cameras": cameras}))


def panoptic(folder: Path) -> None:
    pictures(folder, "ims/{view}/{frame:04}.jpg")
    pictures(folder, "seg/{view}/{frame:04}.png")
    k = [[FOCAL, 0, 16.0], [0, FOCAL, 12.0], [0, 0, 1]]
    for i, split in enumerate(("train", "test")):
        (folder / f"{split}_meta.json").write_text(json.dumps({
            "w": WIDTH, "h": HEIGHT, "k": [[k]] * FRAMES, "w2c": [[pose(i).tolist()]] * FRAMES, "cam_id": [[i]] * FRAMES,
            "fn": [[f"{VIEWS[i]}/{frame + 1:04}.jpg"] for frame in range(FRAMES)]}))
    np.savez(folder / "init_pt_cld.npz", data=np.arange(35.0).reshape(5, 7) / 40)


def transforms(folder: Path) -> None:
    """As nerfstudio writes it."""
    pictures(folder, "images/{view}_{frame:04}.png")
    points(folder / "sparse_pc.ply", ascii_=True)
    frames = [{"file_path": f"images/{view}_{frame + 1:04}.png", "transform_matrix": opengl(i), "time": frame / FRAMES,
               "mask_path": f"images/{view}_0001.png"} for i, view in enumerate(VIEWS) for frame in range(FRAMES)]
    (folder / "transforms.json").write_text(json.dumps({
        "camera_model": "OPENCV", "fl_x": FOCAL, "fl_y": FOCAL, "cx": 16.0, "cy": 12.0, "w": WIDTH, "h": HEIGHT, "k1": 0.05, "k2": 0.01,
        "p1": 0.001, "ply_file_path": "sparse_pc.ply", "test_filenames": ["images/cam01_0001.png"], "frames": frames}))


def splits(folder: Path) -> None:
    """As D-NeRF writes it."""
    pictures(folder, "{view}/r_{frame:03}.png")
    for i, split in enumerate(("train", "test")):
        frames = [{"file_path": f"./{VIEWS[i]}/r_{frame + 1:03}", "rotation": 0.1, "time": frame / FRAMES,
                   "transform_matrix": opengl(2 * i + frame)} for frame in range(FRAMES)]
        (folder / f"transforms_{split}.json").write_text(json.dumps({"camera_angle_x": 0.9, "frames": frames}))


def immersive(folder: Path) -> None:
    entries = []
    for i in range(2):
        video(folder / f"camera_000{i + 1}.mp4", 2)
        entries.append({"name": f"camera_000{i + 1}", "position": [0.1 * i, 0.0, 0.0], "orientation": [0.0, 0.1 * i, 0.0],
                        "focal_length": FOCAL, "pixel_aspect_ratio": 1.0, "principal_point": [16.0, 12.0], "width": float(WIDTH),
                        "height": float(HEIGHT), "radial_distortion": [0.05, -0.01, 0.0], "projection_type": "fisheye"})
    (folder / "models.json").write_text(json.dumps(entries))


def n3v(folder: Path) -> None:
    pictures(folder, "{view}/images/{frame:04}.png")
    points(folder / "points3D_downsample2.ply")
    rows = []
    for i in range(2):
        right, down, forward, centre = np.linalg.inv(pose(i))[:3].T
        rows.append(np.r_[np.stack([down, right, -forward, centre, [HEIGHT, WIDTH, FOCAL]], 1).ravel(), 0.5, 20])
    np.save(folder / "poses_bounds.npy", np.array(rows))


def technicolor(folder: Path) -> None:
    for i in range(2):
        for frame in range(FRAMES):
            picture(folder / f"Fabien_undist_{frame + 51:05}_{i:02}.png", i, frame)
    rows = [" ".join(map(str, [FOCAL, 16, 12, 1, 0.1, *rotations.from_matrices(pose(i)[:3, :3]), *pose(i)[:3, 3]])) for i in range(2)]
    (folder / "cameras_parameters.txt").write_text("\n".join(["f cx cy aspect skew qw qx qy qz tx ty tz", *rows]) + "\n")


def qualisys(folder: Path) -> None:
    for i in range(2):
        for frame in range(FRAMES):
            picture(folder / f"film {1000 + i}" / f"{frame:04}.png", i, frame)
    cameras = []
    for i in range(2):
        turn = " ".join(f'r{a + 1}{b + 1}="{(np.diag([1, -1, -1]) @ pose(i)[:3, :3])[a, b]}"' for a in range(3) for b in range(3))
        cameras.append(
            f'<camera active="1" serial="{1000 + i}" model="Miqus Video">\n<fov_video_max left="0" top="0" right="39" bottom="29"/>\n'
            f'<fov_video left="4" top="3" right="35" bottom="26"/>\n<transform x="{100 * i}" y="3" z="1500" {turn}/>\n'
            f'<intrinsic focallength="9" sensorMinU="0" sensorMaxU="2559" focalLengthU="1920" focalLengthV="1920" centerPointU="1280" '
            'centerPointV="960" skew="0" radialDistortion1="0.02" radialDistortion2="0" radialDistortion3="0" tangentalDistortion1="0.001" '
            'tangentalDistortion2="0"/>\n</camera>')
    body = "\n".join(["<cameras>", *cameras, "</cameras>"])
    (folder / "calib.qca.txt").write_text(f'<?xml version="1.0"?>\n<calibration type="regular">\n{body}\n</calibration>\n')


def colmap_model(folder: Path, names: list[str], binary: bool) -> None:
    """A model with a camera for each name."""
    folder.mkdir(parents=True, exist_ok=True)
    turns = [(*rotations.from_matrices(pose(i)[:3, :3]), *pose(i)[:3, 3]) for i in range(len(names))]
    if not binary:
        texts = {"cameras": [f"{i} OPENCV {WIDTH} {HEIGHT} {FOCAL} {FOCAL} 16 12 0.05 0 0.001 0" for i in range(len(names))],
                 "images": [line for i, name in enumerate(names)
                            for line in (f"{i} {' '.join(map(str, turns[i]))} {i} {name}", "3.5 4.5 -1 6 7 2")],
                 "points3D": [f"{i} {i}.5 0 1 200 100 {i} 0.3 0 1 1 2" for i in range(4)]}
        for name, lines in texts.items():
            (folder / f"{name}.txt").write_text("# a comment\n" + "\n".join(lines) + "\n")
        return
    count = struct.pack("<Q", len(names))
    (folder / "cameras.bin").write_bytes(count + b"".join(
        struct.pack("<IiQQ8d", i, 4, WIDTH, HEIGHT, FOCAL, FOCAL, 16, 12, 0.05, 0, 0.001, 0) for i in range(len(names))))
    (folder / "images.bin").write_bytes(count + b"".join(
        struct.pack("<I7dI", i, *turns[i], i) + name.encode() + b"\0" + struct.pack("<Q2dq", 1, 3.5, 4.5, -1)
        for i, name in enumerate(names)))
    (folder / "points3D.bin").write_bytes(struct.pack("<Q", 4) + b"".join(
        struct.pack("<Q3d3BdQ2i", i, i, 0, 1, 200, 100, i, 0.3, 1, 0, 1) for i in range(4)))


def colmap_text(folder: Path) -> None:
    pictures(folder, "images/{view}/{frame:04}.png")
    colmap_model(folder / "sparse/0", [f"{view}/0001.png" for view in VIEWS], False)


def colmap_binary(folder: Path) -> None:
    pictures(folder, "images/{view}/{frame:04}.png")
    colmap_model(folder / "sparse/0", [f"{view}/0001.png" for view in VIEWS], True)


def colmap_frames(folder: Path) -> None:
    for frame in range(FRAMES):
        for i, view in enumerate(VIEWS):
            picture(folder / f"colmap_{frame}" / "images" / f"{view}.png", i, frame)
        colmap_model(folder / f"colmap_{frame}" / "sparse/0", [f"{view}.png" for view in VIEWS], frame == 0)


def rodrigues(i: int) -> list:
    """The i-th camera's rotation as an axis times an angle."""
    return (2 * rotations.log(rotations.from_matrices(pose(i)[:3, :3]))).tolist()


def toml_camera(i: int, rotation) -> str:
    matrix = [[FOCAL, 0.0, 15.5], [0.0, FOCAL, 11.5], [0.0, 0.0, 1.0]]
    return (f"size = [{WIDTH}, {HEIGHT}]\nmatrix = {matrix}\ndistortions = [0.05, -0.01, 0.001, 0.0, 0.0]\nrotation = {rotation}\n"
            f"translation = {pose(i)[:3, 3].tolist()}\n")


def aniposelib(folder: Path) -> None:
    pictures(folder)
    text = "".join(f'[cam_{i}]\nname = "{view}"\n{toml_camera(i, rodrigues(i))}fisheye = false\n\n' for i, view in enumerate(VIEWS))
    (folder / "calibration.toml").write_text(f'{text}[metadata]\nadjusted = false\nerror = 0.3\nunits = "mm"\n')


def caliscope(folder: Path) -> None:
    """Films of numbered cameras, with the time of each frame."""
    pictures(folder, "recordings/{view}/{frame:04}.png")
    text = "".join(f"[cameras.{i}]\ncam_id = {i}\nignore = false\n{toml_camera(i, pose(i)[:3, :3].tolist())}\n" for i in range(2))
    (folder / "camera_array.toml").write_text(text)
    rows = [f"{frame + 5},{i},{10 + frame / 6 + 0.01 * i}" for frame in range(FRAMES) for i in range(2)]
    (folder / "recordings" / "timestamps.csv").write_text("\n".join(["sync_index,cam_id,frame_time", *rows]) + "\n")


def storage_matrix(values) -> str:
    """A matrix as FileStorage writes it, in lines of YAML."""
    values = np.atleast_2d(np.asarray(values, float))
    data = ", ".join(f"{v:.17g}" for v in values.ravel())
    return f" !!opencv-matrix\n   rows: {values.shape[0]}\n   cols: {values.shape[1]}\n   dt: d\n   data: [ {data} ]\n"


def calibrated(i: int) -> dict:
    """What OpenCV's calibration gives for the i-th camera."""
    return {"K": np.array([[FOCAL, 0, 15.5], [0, FOCAL, 11.5], [0, 0, 1]]), "dist": [[0.05, -0.01, 0.001, 0, 0]],
            "R": pose(i)[:3, :3], "T": pose(i)[:3, 3:]}


def opencv_files(folder: Path) -> None:
    """A YAML file for each camera."""
    pictures(folder)
    for i, view in enumerate(VIEWS):
        values = calibrated(i)
        (folder / f"{view}.yml").write_text(
            f"%YAML:1.0\n---\n# made by hand\nimage_width: {WIDTH}\nimage_height: {HEIGHT}\ncamera_matrix:{storage_matrix(values['K'])}"
            f"distortion_coefficients:{storage_matrix(values['dist'])}rvec: {rodrigues(i)}\ntvec:{storage_matrix(values['T'])}")


def opencv_names(folder: Path) -> None:
    """As EasyMocap writes it: two files for all cameras."""
    pictures(folder)
    names = "names:\n" + "".join(f'   - "{view}"\n' for view in VIEWS)
    for file, keys in (("intri.yml", ("K", "dist")), ("extri.yml", ("R", "Rot", "T"))):
        text = "".join(f"{key}_{view}:{storage_matrix(rodrigues(i) if key == 'R' else calibrated(i)[key.replace('ot', '')])}"
                       for i, view in enumerate(VIEWS) for key in keys)
        (folder / file).write_text(f"%YAML:1.0\n---\n{names}{text}")


def opencv_pair(folder: Path) -> None:
    """As stereo_calib writes it, in XML: the first camera is the world."""
    for i, view in enumerate(("left", "right")):
        for frame in range(FRAMES):
            picture(folder / view / f"{frame + 1:04}.png", i, frame)
    between = pose(1) @ np.linalg.inv(pose(0))
    values = {f"{key}_{side}": calibrated(i)[own] for i, side in enumerate(("left", "right"))
              for key, own in (("camera_matrix", "K"), ("dist_coeffs", "dist"))}
    values |= {"R": between[:3, :3], "T": between[:3, 3:]}
    text = "".join(f'<{key} type_id="opencv-matrix"><rows>{len(value)}</rows><cols>{np.shape(value)[1]}</cols><dt>d</dt><data>'
                   f'{" ".join(f"{v:.17g}" for v in np.ravel(value))}</data></{key}>\n' for key, value in values.items())
    (folder / "stereo.xml").write_text(f'<?xml version="1.0"?>\n<opencv_storage>\n<image_size>\n  {WIDTH} {HEIGHT}</image_size>\n{text}'
                                       "</opencv_storage>\n")


def metashape(folder: Path) -> None:
    pictures(folder)
    places = [" ".join(map(repr, np.linalg.inv(pose(i)).ravel().tolist())) for i in range(2)]
    cameras = "".join(f'<camera id="{i}" sensor_id="{i}" component_id="0" label="{view}"><transform>{places[i]}</transform></camera>'
                      for i, view in enumerate(VIEWS))
    sensors = "".join(f'<sensor id="{i}" type="{kind}"><resolution width="{WIDTH}" height="{HEIGHT}"/><calibration type="{kind}" '
                      f'class="adjusted"><f>{FOCAL}</f><cx>0.5</cx><k1>0.05</k1><k4>0.001</k4>{more}</calibration></sensor>'
                      for i, (kind, more) in enumerate([("frame", "<p1>0.001</p1><b1>0.2</b1>"), ("fisheye", "<b2>0.1</b2>")]))
    (folder / "cameras.xml").write_text(
        f'<?xml version="1.0"?>\n<document version="2.0.0"><chunk label="a"><sensors>{sensors}</sensors><components><component id="0">'
        '<transform><rotation>1 0 0 0 1 0 0 0 1</rotation><translation>0 0 0</translation><scale>1</scale></transform></component>'
        f'</components><cameras>{cameras}</cameras></chunk></document>\n')


def scan_table(folder: Path) -> None:
    pictures(folder)
    rows = [f"{view}.png,{i},2,3,{10 * i},80,5,30,0.01,-0.02,0.05,0.01,0,0.001,0.001,0" for i, view in enumerate(VIEWS)]
    (folder / "cameras.csv").write_text("\n".join(["#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2", *rows]) + "\n")


def scan_metadata(folder: Path) -> None:
    pictures(folder)
    for i, view in enumerate(VIEWS):
        (folder / f"{view}.xmp").write_text(
            '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description '
            'xmlns:xcr="http://www.capturingreality.com/ns/xcr/1.1#" xcr:Version="3" xcr:DistortionModel="division" '
            f'xcr:FocalLength35mm="30" xcr:Skew="0" xcr:AspectRatio="1" xcr:PrincipalPointU="0.01" xcr:PrincipalPointV="0">'
            f'<xcr:Rotation>{" ".join(map(repr, pose(i)[:3, :3].ravel().tolist()))}</xcr:Rotation><xcr:Position>{i} 0.5 3</xcr:Position>'
            '<xcr:DistortionCoeficients>-0.1 0 0 0 0 0</xcr:DistortionCoeficients></rdf:Description></rdf:RDF></x:xmpmeta>\n')


LAYOUTS = {"fastgs": [fastgs], "panoptic": [panoptic], "transforms": [transforms, splits], "immersive": [immersive], "n3v": [n3v],
           "technicolor": [technicolor], "qualisys": [qualisys], "colmap": [colmap_text, colmap_binary, colmap_frames],
           "metashape": [metashape], "realityscan": [scan_table, scan_metadata],
           "toml": [aniposelib, caliscope], "opencv": [opencv_files, opencv_names, opencv_pair]}
"""What makes captures of each layout that has a description."""


def contents(folder: Path) -> dict[str, bytes]:
    """{relative path: content} of all files in a folder."""
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file()}
