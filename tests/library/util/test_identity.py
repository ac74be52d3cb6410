# SPDX-License-Identifier: GPL-3.0-or-later
"""A rewritten file is noticed, whatever its time and its size say."""
import os

import pytest

from fastgs_blender.util.errors import FastGSError
from fastgs_blender.util.identity import status_of


def test_a_later_or_longer_or_other_file_is_another(tmp_path):
    path = tmp_path / "model"
    path.write_bytes(b"one")
    seen = {status_of(str(path))}
    os.utime(path, ns=(1, 1))
    seen.add(status_of(str(path)))
    path.write_bytes(b"longer")
    seen.add(status_of(str(path)))
    (tmp_path / "other").write_bytes(b"longer")
    os.replace(tmp_path / "other", path)
    seen.add(status_of(str(path)))
    assert len(seen) == 4


@pytest.mark.parametrize("name", ["gone", "a\0b"])
def test_a_file_that_is_gone_or_has_no_name_is_an_error(tmp_path, name):
    with pytest.raises(FastGSError, match="no such file"):
        status_of(str(tmp_path / name))
