# SPDX-License-Identifier: GPL-3.0-or-later
"""Compiles kernels with numba, and keeps the machine code in a cache folder.

Kernels are compiled without Python's lock and without numba's own threads (see threads.py).  The code is cached in a folder
that the user may write to (cache.py).
"""
from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import time
from pathlib import Path

import numba
from llvmlite import binding
from numba import _dynfunc  # type: ignore[attr-defined]  # an extension module
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile, InTreeCacheLocator
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.runtime import nrt

from ...util.remarks import remark
from . import aside, cache

FOLDER = cache.folder()


class Place(InTreeCacheLocator):
    """Where a function's code lies: by the name of its source's folder, wherever that is installed (cache.folder() has the version)."""

    def __init__(self, function, file):
        super().__init__(function, file)
        self._cache_path = str(FOLDER / Path(file).parent.name)


class Code(CompileResultCacheImpl):
    """Machine code, as numba stores it, in its Place."""

    _locator_classes = [Place]

    def rebuild(self, target_context, payload):
        """The stored function.  numba's own way parses its bitcode and lists all symbols in it, 0.02 s for a first frame.  Bitcode is
        needed where a function is compiled that calls this one, so it is parsed then.  Python calls one symbol."""
        (name, kind, (machine_code, bitcode)), described, *rest = payload
        target_context.codegen()._engine._defined_symbols.add(described.llvm_cpython_wrapper_name)
        nothing = binding.parse_assembly("").as_bitcode()
        compiled = super().rebuild(target_context, ((name, kind, (machine_code, nothing)), described, *rest))
        compiled.library._get_module_for_linking = functools.partial(binding.parse_bitcode, bitcode)
        return compiled


@functools.cache
def _runtime():
    """Let machine code find the functions of numba's runtime.  numba's own rtsys.initialize() compiles some more, which only compiling
    needs: 0.02 s, and 20 MB of LLVM that the process holds from then on."""
    for name, address in nrt._nrt.c_helpers.items():
        binding.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)


class Files(IndexDataCacheFile):
    """The files of a function, by their signatures.  numba numbers them in an index that it writes first: of two processes that compile at
    once, one may then find the other's machine code under its own signature, and run it."""

    def save(self, key, data):
        """Machine code first, under a name of its own, and then the index."""
        name = self._data_name(int(hashlib.sha256(self._dump(key)).hexdigest()[:10], 16))
        self._save_data(name, data)
        self._save_index(self._load_index() | {key: name})


class Kept(FunctionCache):
    """Machine code in the cache.  numba's own class has everything ready that compiling needs before it reads any: 0.15 s."""

    _impl_class = Code

    def __init__(self, function):
        super().__init__(function)
        self._cache_file = Files(self._cache_path, self._impl.filename_base, self._impl.locator.get_source_stamp())

    def load_overload(self, sig, target_context):
        """The code for a signature, or None, as numba's does it.  Code that is compiled aside is waited for."""
        _runtime()
        with self._guard_against_spurious_io_errors():
            while True:
                is_coming = aside.is_compiling(self._py_func.__name__)
                found = self._load_overload(sig, target_context)
                if found or not is_coming:
                    return found
                time.sleep(0.02)


def _not_run(compiled):
    """What stands for a kernel in the process aside: it compiles, if that is this process's work, and finds nothing."""
    def compile_only(*args):
        if compiled.__name__ in aside.KERNELS:
            compiled.compile(tuple(compiled.typeof_pyval(arg) for arg in args))
        return 0
    return compile_only


def kernel(function):
    """Decorator: compile on the first call, run without Python's lock, keep the machine code."""
    options = dict(nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, boundscheck=False)
    compiled = numba.njit(**options)(function)
    with contextlib.suppress(OSError, RuntimeError):  # nowhere to write: compile anew in every process
        compiled._cache = Kept(function)
    return _not_run(compiled) if aside.is_here() else compiled


class Part(JITCodeLibrary):
    """LLVM's code of a function that becomes part of its callers.  By itself it never becomes machine code, as nothing would run that."""

    def _finalize_final_module(self):
        self._finalize_dynamic_globals()
        self._finalized = True


REFUSE = ctypes.cast(ctypes.pythonapi.PyErr_BadArgument, ctypes.c_void_p).value
"""Where Python finds what raises a TypeError."""


class Inlining(Compiler):
    """numba's compiler, for functions that become part of their callers.  Python cannot call them: that raises a TypeError."""

    def compile_extra(self, func):
        """As numba's, without machine code."""
        state, name = self.state, func.__name__
        state.library = Part(state.targetctx.codegen(), name)
        state.flags.no_compile = state.flags.no_cpython_wrapper = state.flags.no_cfunc_wrapper = True
        result = super().compile_extra(func)
        entry = _dynfunc.make_function(result.fndesc.lookup_module(), name, "", REFUSE, result.environment, (result.library,))
        state.targetctx.insert_user_function(entry, result.fndesc, [result.library])
        return result._replace(entry_point=entry)


inline = numba.njit(error_model="numpy", fastmath={"contract", "nsz"}, boundscheck=False, inline="never", forceinline=True,
                    pipeline_class=Inlining)
"""Decorator of the small functions that kernels call; they always become part of them, whatever LLVM thinks of their size."""


_announced: set[str] = set()


def announce(work: str = "picture"):
    """Before a work of warm.py: without kernels in the cache, say on one line that they are being compiled; have some compiled aside."""
    if work in _announced:
        return
    if not _announced and not cache.is_begun():
        remark("FAST-GS: compiling the renderer for this machine; this happens once and takes some ten seconds.")
    _announced.add(work)
    aside.begin(work)
