# SPDX-License-Identifier: GPL-3.0-or-later
"""Modules are imported without a search for garbage, which goes on afterwards, whatever becomes of the import."""
from __future__ import annotations

import gc

import pytest

from fastgs_blender.util.importing import import_quickly


def test_no_garbage_is_looked_for_while_a_module_is_imported(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "looked_for.py").write_text("import gc\nwhile_imported = gc.isenabled()\n", "ascii")
    (tmp_path / "cannot_be_imported.py").write_text("import gc\nraise KeyError(gc.isenabled())\n", "ascii")
    assert import_quickly("looked_for").while_imported is False and gc.isenabled()
    with pytest.raises(KeyError, match="False"):
        import_quickly("cannot_be_imported")
    assert gc.isenabled()


def test_a_program_that_switched_it_off_finds_it_off():
    gc.disable()
    try:
        import_quickly("colorsys")
        assert not gc.isenabled()
    finally:
        gc.enable()
