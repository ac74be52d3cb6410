# SPDX-License-Identifier: GPL-3.0-or-later
"""A compilation ahead that was stopped is begun again: the cache counts as filled when it came to its end, and not before."""
from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from fastgs_blender.kernels.cpu import aside, cache, warm
from fastgs_blender.kernels.cpu.jit import Files, inline, kernel


def _printed(folder, *arguments, **variables):
    """What another Python prints, with the modules of this one and a cache of its own in the folder."""
    path = os.pathsep.join(filter(None, sys.path))
    environment = os.environ | {"FASTGS_CACHE_DIR": str(folder / "cache"), "PYTHONPATH": path} | variables
    return subprocess.run([sys.executable, *arguments], env=environment, check=True, capture_output=True, text=True).stdout.split()


@pytest.mark.slow
def test_the_cache_is_filled_when_compilation_came_to_its_end(tmp_path, monkeypatch):
    monkeypatch.setenv("FASTGS_CACHE_DIR", str(tmp_path))
    assert not cache.is_begun() and not cache.is_filled()
    kernel = cache.folder() / "raster_0" / "raster.rasterise-1.py311.nbi"
    kernel.parent.mkdir(parents=True)
    kernel.touch()
    assert cache.is_begun() and not cache.has_first() and not cache.is_filled()

    def stopped(fraction):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        warm.compile_all(stopped)
    assert cache.has_first() and not cache.is_filled(), "what a first picture needs comes first"
    warm.compile_all()
    assert cache.is_filled()
    cache.clear()
    assert not cache.is_begun() and not cache.is_filled()


@pytest.mark.slow
def test_machine_code_is_found_wherever_the_same_source_is_installed(tmp_path):
    source = """from fastgs_blender.kernels.cpu.jit import kernel
@kernel
def added(x):
    return x + {}
print(added(1), sum(added.stats.cache_hits.values()))
"""

    def run(place, number):
        file = tmp_path / place / "same" / "one.py"
        file.parent.mkdir(parents=True)
        file.write_text(source.format(number), "ascii")
        return _printed(tmp_path, file)

    assert [run("here", 1), run("there", 1), run("new", 2)] == [["2", "0"], ["2", "1"], ["3", "0"]]


@pytest.mark.slow
def test_bitcode_of_cached_code_is_parsed_where_another_function_is_compiled_with_it(tmp_path):
    """Not when the code is loaded: that took a quarter of the time in which a process loads kernels."""
    one = """from llvmlite import binding
from fastgs_blender.kernels.cpu.jit import kernel
parsed, parse = [], binding.parse_bitcode
binding.parse_bitcode = lambda code: parsed.append(code) or parse(code)
@kernel
def added(x):
    return x + 1
if __name__ == "__main__":
    print(added(1), sum(added.stats.cache_hits.values()), any(len(code) > 2000 for code in parsed))
"""
    two = """from one import added, kernel
@kernel
def twice(x):
    return added(x) + added(x + 1)
print(twice(1), sum(added.stats.cache_hits.values()), sum(twice.stats.cache_hits.values()))
"""
    (tmp_path / "one.py").write_text(one, "ascii")
    (tmp_path / "two.py").write_text(two, "ascii")

    def run(name):
        return _printed(tmp_path, tmp_path / name)

    assert run("one.py") == ["2", "0", "False"]
    assert run("one.py") == ["2", "1", "False"], "code is loaded without its bitcode"
    assert run("two.py")[0] == "5", "and is compiled into another function all the same"
    assert run("two.py") == ["5", "0", "1"], "which is kept as well"


def test_a_function_that_becomes_part_of_kernels_has_no_machine_code_and_refuses_python():
    half = inline(lambda x: x / 2)
    quarter = kernel(lambda x: half(half(x)))
    assert quarter(8.0) == 2
    with pytest.raises(TypeError):
        half(8.0)
    (result,) = half.overloads.values()
    assert not result.library._codegen._engine.is_symbol_defined(result.fndesc.llvm_func_name)


def test_processes_that_save_at_once_never_read_what_the_other_has_compiled(tmp_path):
    one, other = (Files(str(tmp_path), "kernel", "stamp") for _ in range(2))
    other._load_index = dict  # it had read the index before one wrote it
    one.save(("float",), 1)
    other.save(("int",), 2)
    assert one.load(("int",)) == 2 and one.load(("float",)) in (1, None)
    one.save(("float",), 1)

    def killed(name, data):
        raise KeyboardInterrupt

    other._save_data = killed
    with pytest.raises(KeyboardInterrupt):
        other.save(("text",), 3)
    assert one.load(("text",)) is None and one.load(("float",)) == 1


def test_the_process_aside_compiles_its_kernels_and_runs_none(tmp_path):
    source = """from fastgs_blender.kernels.cpu.jit import kernel
@kernel
def project(x):
    x[0] += 1
@kernel
def another(x):
    x[0] += 1
import numpy as np
x = np.zeros(1)
print(project(x), another(x), x[0])
"""
    (tmp_path / "one.py").write_text(source, "ascii")
    assert _printed(tmp_path, tmp_path / "one.py", **{aside.VARIABLE: "1"}) == ["0", "0", "0.0"]
    assert [path.name.split("-")[0] for path in tmp_path.rglob("*.nbi")] == ["one.project"]


@pytest.mark.slow
@pytest.mark.parametrize("work", ["picture", "features", "step"])
def test_a_second_process_compiles_what_takes_long(tmp_path, work):
    """This one finds that code in the cache, and begins no other process when the next one starts.  The library may lie where Python does
    not look, as in a training that Blender has started."""
    shutil.copytree(Path(cache.__file__).parents[2], tmp_path / "fastgs_blender")
    with open(tmp_path / "fastgs_blender/kernels/cpu/sort.py", "a", encoding="ascii") as file:
        file.write("# of another version\n")
    source = """import sys
from fastgs_blender.jobs import child
child.load_library(sys.argv[2])
for name in [name for name in sys.modules if name.startswith("fastgs_blender.")]:
    del sys.modules[name]
from fastgs_blender.kernels.cpu import aside, project, project_backward, warm
warm.aside.end_with_parent = lambda: None
warm.WORK[sys.argv[1]]()
print(sum(project.project.stats.cache_hits.values()), sum(project_backward.project_backward.stats.cache_hits.values()),
      sum(project.opaque.stats.cache_hits.values()), aside._process is not None)
"""

    def run(threads):
        return _printed(tmp_path, "-c", source, work, str(tmp_path), FASTGS_THREADS=threads)

    backward = str(int(work == "step"))
    assert run("2") == ["1", backward, "0", "True"]
    assert run("2") == ["1", backward, "1", "False"]
    shutil.rmtree(tmp_path / "cache")
    assert run("1") == ["0", "0", "0", "False"]
