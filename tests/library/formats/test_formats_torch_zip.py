# SPDX-License-Identifier: GPL-3.0-or-later
"""PyTorch's zip files without torch: tensors come out, nothing is ever executed."""
from __future__ import annotations

import os
import pickle
import struct
import tracemalloc
import zipfile

import numpy as np
import pytest
import torch

import fastgs_blender as fg
from fastgs_blender.formats.torch_zip import STORAGES, Tensor, TorchFile, write

pytestmark = pytest.mark.filterwarnings("error")
EMPTY = b"ccollections\nOrderedDict\n)R"


def archive(path, program, parts=None, root="archive/", compression=zipfile.ZIP_STORED):
    """A file with this pickle and these parts."""
    with zipfile.ZipFile(path, "w", compression) as z:
        z.writestr(f"{root}data.pkl", program)
        for name, data in (parts or {}).items():
            z.writestr(root + name, data)
    return TorchFile(path).content


def text(value):
    return b"X" + struct.pack("<I", len(value)) + value.encode()


def number(value):
    return b"\x8a\x08" + struct.pack("<q", value)


def storage(kind="FloatStorage", key="0", size=24):
    return b"(" + text("storage") + b"ctorch\n" + kind.encode() + b"\n" + text(key) + text("cpu") + number(size) + b"tQ"


def tensor(source=None, offset=0, shape=(4, 6), stride=(6, 1), function=b"ctorch._utils\n_rebuild_tensor_v2\n", rest=b"\x89" + EMPTY):
    """Instructions that leave a tensor on the stack."""
    def dims(values):
        return b"(" + b"".join(number(v) for v in values) + b"t"
    return function + b"(" + (source or storage()) + number(offset) + dims(shape) + dims(stride) + rest + b"tR"


def table(*values):
    """A whole program: {"0": value, "1": value, ...}."""
    return b"\x80\x02}(" + b"".join(text(str(i)) + v for i, v in enumerate(values)) + b"u."


NUMBERS = np.arange(24, dtype="<f4")
DATA = {"data/0": NUMBERS.tobytes()}


def test_what_is_written_is_read(rng, tmp_path):
    tensors = {"mlp1.weight": rng.normal(size=(6, 12, 1, 1)), "b": rng.normal(size=(5,)), "scalar": np.array(3.0), "none": np.zeros((0, 3))}
    write(tmp_path / "a.pt", tensors)
    content = TorchFile(tmp_path / "a.pt").content
    assert list(content) == list(tensors)
    for name, values in tensors.items():
        assert content[name].shape == values.shape
        np.testing.assert_array_equal(content[name].read(), values.astype(np.float32))
    first = (tmp_path / "a.pt").read_bytes()
    write(tmp_path / "a.pt", tensors)
    assert (tmp_path / "a.pt").read_bytes() == first


def test_torch_agrees(rng, tmp_path):
    write(tmp_path / "ours.pt", {"w": rng.normal(size=(3, 6, 1, 1)), "v": rng.normal(size=4)})
    theirs, ours = torch.load(tmp_path / "ours.pt", weights_only=True), TorchFile(tmp_path / "ours.pt").content
    for name in ("w", "v"):
        np.testing.assert_array_equal(theirs[name].numpy(), ours[name].read())
    module = torch.nn.Sequential(torch.nn.Conv2d(12, 6, 1, bias=False), torch.nn.Linear(3, 2).half())
    saved = {"state": module.state_dict(), "named": dict(module.named_parameters())}
    for protocol in (2, 4, 5):
        torch.save(saved, tmp_path / "theirs.pt", pickle_protocol=protocol)
        content = TorchFile(tmp_path / "theirs.pt").content
        for name, value in module.state_dict().items():
            np.testing.assert_array_equal(content["state"][name].read(), value.numpy())
            np.testing.assert_array_equal(content["named"][name].read(), value.numpy())


@pytest.mark.parametrize("order", ["little", "big"])
@pytest.mark.parametrize("kind", STORAGES)
def test_kinds_of_numbers_and_byte_orders(tmp_path, kind, order):
    values = np.array([0, 1, 1, 0, 1, 1] if kind == "BoolStorage" else [0, 1, 2, 5, 100, 120])
    mark = "<" if order == "little" else ">"
    if kind == "BFloat16Storage":
        data = (values.astype(np.float32).view(np.uint32) >> 16).astype(mark + "u2").tobytes()
    else:
        data = values.astype(mark + STORAGES[kind]).tobytes()
    program = table(tensor(storage(kind, size=6), shape=(2, 3), stride=(3, 1)))
    content = archive(tmp_path / "a.pt", program, {"data/0": data, "byteorder": order})
    np.testing.assert_array_equal(content["0"].read(), values.reshape(2, 3))


def test_views_parameters_and_old_names(tmp_path):
    program = table(
        tensor(offset=2, shape=(3, 2), stride=(1, 6)), tensor(shape=(5,), stride=(0,)), tensor(shape=(), stride=(), offset=7),
        tensor(function=b"ctorch._utils\n_rebuild_tensor\n", rest=b""),
        b"ctorch._utils\n_rebuild_parameter\n(" + tensor() + b"\x88" + EMPTY + b"tR",
        b"](" + tensor() + b"K\x05N\x88e")
    content = archive(tmp_path / "a.pt", program, DATA, root="point_cloud/")
    grid = NUMBERS.reshape(4, 6)
    np.testing.assert_array_equal(content["0"].read(), grid[:2, 2:5].T)
    np.testing.assert_array_equal(content["1"].read(), np.zeros(5))
    assert content["2"].read() == 7
    np.testing.assert_array_equal(content["3"].read(), grid)
    np.testing.assert_array_equal(content["4"].read(), grid)
    assert isinstance(content["5"][0], Tensor)
    assert content["5"][1:] == [5, None, True]


class Bomb:
    def __reduce__(self):
        return os.mkdir, ("pwned",)


def doubling_lists(count: int) -> bytes:
    """Each list holds the next one twice, and is still empty when it is named."""
    def get(k):
        return b"j" + struct.pack("<I", k)

    made = b"".join(b"]r" + struct.pack("<I", k) for k in range(count))
    return b"\x80\x02(" + made + b"".join(get(k) + 2 * (get(k + 1) + b"a") for k in range(count - 1)) + b"t."


REFUSED = {
    "a call": pickle.dumps({"a": Bomb()}, 2),
    "a call, protocol 5": pickle.dumps({"a": Bomb()}, 5),
    "a call, protocol 0": pickle.dumps({"a": Bomb()}, 0),
    "eval": b"\x80\x02cbuiltins\neval\n" + text("1") + b"\x85R.",
    "an object": b"\x80\x02ccollections\nOrderedDict\n)\x81.",
    "an inst": b"\x80\x02(iposix\nsystem\n.",
    "a tensor of a text": table(tensor(text("a"))),
    "a storage of eval": table(tensor(b"(" + text("storage") + b"cbuiltins\neval\n" + text("0") + text("cpu") + b"K\x01tQ")),
    "a storage that is not there": table(tensor(storage(key="7"))),
    "a storage outside": table(tensor(storage(key="../../x"))),
    "larger than its numbers": table(tensor(shape=(5, 6))),
    "offset beyond": table(tensor(offset=1)),
    "stride beyond": table(tensor(stride=(7, 1))),
    "negative stride": table(tensor(offset=23, stride=(-6, -1))),
    "negative shape": table(tensor(shape=(-4, -6))),
    "huge repeats": table(tensor(shape=(2**40,), stride=(0,))),
    "overflowing": table(tensor(shape=(2**47, 2**47), stride=(2**47, 2**47))),
    "more strides": table(tensor(stride=(6, 1, 1))),
    "shape of floats": table(tensor(shape=(), stride=()).replace(b"(t(t", b"(G" + struct.pack(">d", 2.0) + b"t(K\1t")),
    "an ordered dict with contents": b"\x80\x02ccollections\nOrderedDict\n" + text("a") + b"\x85R.",
    "attributes of a list": b"\x80\x02]}b.",
    "keys that are tables": b"\x80\x02}()" + text("a") + b"u.",
    "an odd number of items": b"\x80\x02}(" + text("a") + b"u.",
    "no mark": b"\x80\x02}" + text("a") + b"u.",
    "nothing on the stack": b"\x80\x02u.",
    "two values": b"\x80\x02}}.",
    "an unknown memo": b"\x80\x02h\x05.",
    "a memo of nothing": b"\x80\x02q\x05.",
    "a huge memo": b"\x80\x02}r\xff\xff\xff\xff0.",
    "a text cut short": b"\x80\x02X\xff\xff\xff\x7fabc.",
    "a long number": b"\x80\x02\x8b\xff\xff\xff\x7f1.",
    "an endless number": b"\x80\x02I" + b"9" * 100_000 + b"\n.",
    "no end": b"\x80\x02}",
    "nothing": b"",
    "noise": bytes(range(256)),
    "tuples that double": b"\x80\x02K\1" + b"q\1h\1\x86" * 60 + b".",
    "lists that double, filled from outside": doubling_lists(60),
    "a list in itself": b"\x80\x02]q\0h\0a.",
    "deep tuples as a key": b"\x80\x02}" + b")" + b"\x85" * 100_000 + b"Ns.",
}


@pytest.mark.parametrize("case", REFUSED)
def test_everything_else_is_refused(tmp_path, monkeypatch, case):
    monkeypatch.chdir(tmp_path)
    tracemalloc.start()
    try:
        with pytest.raises(fg.FastGSError):
            archive(tmp_path / "a.pt", REFUSED[case], DATA)
        assert tracemalloc.get_traced_memory()[1] < 64 << 20
    finally:
        tracemalloc.stop()
    assert not (tmp_path / "pwned").exists()


def test_deep_nesting_is_only_deep(tmp_path):
    content = archive(tmp_path / "a.pt", b"\x80\x02" + b"]" * 100_000 + b"a" * 99_999 + b".")
    while content:
        content = content.pop()


@pytest.mark.parametrize("size", [3 << 20, 5 << 20])
def test_pickles_are_bounded(tmp_path, size):
    with pytest.raises(fg.FastGSError):
        archive(tmp_path / "a.pt", b"\x80\x02X" + struct.pack("<I", size) + bytes(size) + b"0.")


def test_a_zip_bomb_is_refused(tmp_path):
    with pytest.raises(fg.FastGSError, match="compressed"):
        archive(tmp_path / "a.pt", table(tensor()), {"data/0": bytes(1 << 24)}, compression=zipfile.ZIP_DEFLATED)


def test_other_zips_and_broken_ones(tmp_path):
    path = tmp_path / "a.pt"
    for parts in ({}, {"readme": b""}, {"a/data.pkl": b"", "b/data.pkl": b""}):
        with zipfile.ZipFile(path, "w") as z:
            for name, data in parts.items():
                z.writestr(name, data)
        with pytest.raises(fg.FastGSError, match="PyTorch"):
            TorchFile(path)
    write(path, {"w": NUMBERS})
    data = path.read_bytes()
    for length in range(0, len(data), 13):
        path.write_bytes(data[:length])
        with pytest.raises(fg.FastGSError):
            TorchFile(path)
    path.write_bytes(data.replace(NUMBERS.tobytes(), NUMBERS[::-1].tobytes()))
    with pytest.raises(fg.FastGSError):  # the check sum
        TorchFile(path).content["w"].read()


def test_unknown_byte_order(tmp_path):
    with pytest.raises(fg.FastGSError, match="byte order"):
        archive(tmp_path / "a.pt", table(tensor()), {**DATA, "byteorder": b"middle"})


def test_sizes_that_the_directory_only_claims(tmp_path):
    archive(tmp_path / "a.pt", table(tensor()), DATA)
    data = (tmp_path / "a.pt").read_bytes()
    at = data.index(b"PK\x01\x02", data.index(b"PK\x01\x02") + 1)  # the storage's entry
    claim = struct.pack("<II", 0x7FFFFFF0, 0x7FFFFFF0)
    (tmp_path / "a.pt").write_bytes(data[:at + 20] + claim + data[at + 28:])
    tracemalloc.start()
    with pytest.raises(fg.FastGSError):
        TorchFile(tmp_path / "a.pt").content["0"].read()
    assert tracemalloc.get_traced_memory()[1] < 1 << 20
    tracemalloc.stop()
