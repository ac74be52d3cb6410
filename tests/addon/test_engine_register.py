# SPDX-License-Identifier: GPL-3.0-or-later
"""Coming and going: the extension registers, unregisters, and leaves nothing behind."""


def test_properties_exist(scene, splat_object):
    obj = splat_object("//x.ply")
    assert obj.fastgs.filepath == "//x.ply"
    assert scene.fastgs.depth == 'EXPECTED'
    assert not scene.view_layers[0].fastgs.use_pass_alpha
