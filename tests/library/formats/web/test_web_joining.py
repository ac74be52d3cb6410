# SPDX-License-Identifier: GPL-3.0-or-later
"""ES modules joined to one script."""
import shutil
import subprocess

import pytest

import fastgs_blender as fg
from fastgs_blender.formats.web.joining import joined

FILES = {
    "main.js": 'import {twice, two as other} from "./parts/twice.js";\nimport * as base from "./base.js";\n'
               'const secret = 1;\nawait 0;\nconsole.log(twice(21), other, base.ONE, new base.Thing().value, secret);\n',
    "parts/twice.js": 'import {ONE, hidden} from "../base.js";\nconst secret = 2;\nvar two = "two";\nexport { two };\n'
                      "export function twice(x) { return hidden() + secret * x * ONE; }\n",
    "base.js": 'const secret = 0;\nexport const ONE = 1;\nexport class Thing { value = "thing"; }\nexport async function later() {}\n'
               'function hidden() { return secret; }\nexport {hidden};\n',
    "unused.js": "export const never = 1;\n",
}


def test_each_module_that_is_needed_comes_once_before_its_users():
    text = joined("main.js", FILES)
    assert text.count("class Thing") == 1 and "never" not in text
    assert text.index("class Thing") < text.index("function twice") < text.index("console.log")
    assert not any(line.startswith(("import", "export")) for line in text.splitlines())


@pytest.mark.skipif(not shutil.which("node"), reason="node is not installed; pages in a browser hold the same")
def test_the_script_does_what_the_modules_do(tmp_path):
    for name, text in FILES.items():
        (tmp_path / "parts").mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    (tmp_path / "package.json").write_text('{"type": "module"}')
    (tmp_path / "joined.mjs").write_text(joined("main.js", FILES))
    for name in ("main.js", "joined.mjs"):
        assert subprocess.run(["node", tmp_path / name], capture_output=True, text=True, check=True).stdout == "42 two 1 thing 1\n"


@pytest.mark.parametrize(("text", "word"), [
    ('import thing from "./base.js";', "import thing"), ('import "./base.js";', "cannot be joined"),
    ("export default 1;", "export default"), ('export * from "./base.js";', "cannot be joined"),
    ('import {x} from "./gone.js";', "gone.js"), ('import {x} from "./main.js";', "each other"),
    ('const x = "</script>";', "main.js"), ("// <!-- x", "main.js")])
def test_what_cannot_be_joined_is_named(text, word):
    with pytest.raises(fg.FastGSError, match=word):
        joined("main.js", FILES | {"main.js": text + "\n"})
