"""How numba compiles kernels, with a cache on disk that depends on callees and replaces damaged files.

By default numba makes every kernel callable from Python and C, and optimises and translates each with all its callees,
so that a kernel three calls down is translated three times and more, and most of the result is never called. Here
kernels that are called by kernels stay unoptimised LLVM code until they are linked into the one that Python calls.

numba's own file cache looks only at the file of the function itself, so that an edited callee in another file leaves a
stale caller behind. Here the key of a kernel is a digest of its code, of the global constants it uses, of the layout of
the NamedTuples it takes and, recursively, of the kernels it calls: whatever changes the result changes the key.

Both use private interfaces of numba. The gain, in processor seconds of ``bayeq discover`` of 4,000 rows (two cores,
medians of 4 first and 16 later starts, alternating): 40.1 s at first and 2.7 s later; 61.2 and 3.9 s, and a cache five
times as large, by ``numba.njit(cache=True)``; 45.5 and 3.2 s by numba's cache with this compiler.
"""

from __future__ import annotations

import hashlib
import marshal
import re
import sys
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, TypeGuard

import llvmlite.binding as llvm
import numba
import numpy as np
from numba.core import caching
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.runtime import rtsys

OPTIONS = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}


class _EntryLibrary(JITCodeLibrary):  # type: ignore[misc]
    """LLVM code of a kernel that Python calls, with that of its callees."""

    def serialize_using_object_code(self) -> tuple[str, str, tuple[bytes, bytes]]:
        """Machine code and, in place of the LLVM code, stubs of its functions, which numba looks up on loading.

        numba would parse the LLVM code at every start, for kernels that call this one; but these use `_InnerLibrary`.
        """
        functions = [f for f in self._final_module.functions if not f.is_declaration]
        names = [f.name for f in functions if f.linkage == llvm.Linkage.external]
        stub = llvm.parse_assembly("\n".join(f'define void @"{name}"() {{ ret void }}' for name in names))
        return self.name, "object", (self._get_compiled_object(), stub.as_bitcode())


class _InnerLibrary(_EntryLibrary):
    """LLVM code of a kernel that kernels call: it is optimised and becomes machine code as part of its callers."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """0: without machine code there is no pointer."""
        self._ensure_finalized()
        return 0

    @property
    def codegen(self) -> Any:
        """The object whose `set_env` numba calls."""
        return self

    def set_env(self, name: str, env: object) -> None:
        """Does nothing: only machine code holds a pointer to its Python environment."""


class _EntryCompiler(Compiler):  # type: ignore[misc]
    library = _EntryLibrary

    def define_pipelines(self) -> Any:
        state = self.state
        state.library = self.library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return super().define_pipelines()


class _InnerCompiler(_EntryCompiler):
    library = _InnerLibrary


def _options(function: Callable[..., Any]) -> dict[str, bool]:
    """The options with which `bayeq.kernels.kernel` marked a function."""
    return {name: bool(getattr(function, name, False)) for name in ("reordered", "borrowing")}


def inner_dispatcher(function: Callable[..., Any]) -> Any:
    """numba's dispatcher of a function that kernels call.

    A borrowing function is compiled without numba's memory management (``_nrt``): its caller keeps its arrays alive.
    """
    options = {**OPTIONS, "fastmath": _allowed(function), "_nrt": not _options(function)["borrowing"]}
    return numba.njit(**options, no_cpython_wrapper=True, pipeline_class=_InnerCompiler)(function)


def _allowed(function: Callable[..., Any]) -> set[str] | bool:
    return {"reassoc", "contract"} if _options(function)["reordered"] else False


def _bare(code: CodeType) -> bytes:
    """Bytes of a code object without its file name, line numbers and comments."""
    consts = tuple(_bare(c) if isinstance(c, CodeType) else c for c in code.co_consts)
    return marshal.dumps((code.co_code, consts, code.co_names, code.co_varnames, code.co_freevars))


def _names(code: CodeType) -> set[str]:
    """Names of globals, and of attributes, in a code object and those within it."""
    return set(code.co_names).union(*(_names(c) for c in code.co_consts if isinstance(c, CodeType)))


def _layout(cls: type) -> str:
    """Fields of a NamedTuple, in order, with the fields of nested NamedTuples."""
    space = vars(sys.modules[cls.__module__])
    fields = []
    for name, annotation in cls.__annotations__.items():
        inner = annotation if isinstance(annotation, type) else space.get(str(annotation))
        fields.append(f"{name}:{_layout(inner) if _is_record(inner) else annotation}")
    return f"{cls.__name__}({','.join(fields)})"


def _is_record(value: object) -> TypeGuard[type]:
    return isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_fields")


def _digest(function: Callable[..., Any]) -> str:
    """Digest of a function's code, the constants it reads, the records it takes and the kernels it calls."""
    function = getattr(function, "py_func", function)
    seen: set[int] = set()
    sha = hashlib.sha256()

    def visit(f: Callable[..., Any]) -> None:
        if id(f) in seen:
            return
        seen.add(id(f))
        sha.update(_bare(f.__code__))
        sha.update(repr((f.__defaults__, _options(f))).encode())
        for annotation in f.__annotations__.values():
            record = annotation if isinstance(annotation, type) else f.__globals__.get(str(annotation))
            if _is_record(record):
                sha.update(_layout(record).encode())
        for name in sorted(_names(f.__code__) & f.__globals__.keys()):
            value = f.__globals__[name]
            sha.update(name.encode())
            compiled = getattr(value, "py_func", None)
            if compiled is not None:
                visit(compiled)
            elif _is_record(value):
                sha.update(_layout(value).encode())
            elif isinstance(value, np.ndarray):
                sha.update(value.tobytes())
            elif value is not None and not isinstance(value, ModuleType) and not callable(value):
                sha.update(repr(value).encode())

    visit(function)
    return sha.hexdigest()


class _CacheFile(caching.IndexDataCacheFile):  # type: ignore[misc]
    """Index and code of a kernel, each followed by a checksum: damaged machine code would crash the process."""

    def _dump(self, obj: object) -> bytes:
        data: bytes = super()._dump(obj)
        return data + hashlib.sha256(data).digest()  # the unpickler ignores the checksum

    def _load_data(self, name: str) -> object:
        content = Path(self._data_path(name)).read_bytes()
        size = hashlib.sha256().digest_size
        if hashlib.sha256(content[:-size]).digest() != content[-size:]:
            raise ValueError(f"{name} is damaged")
        return super()._load_data(name)


class _KernelCache(caching.FunctionCache):  # type: ignore[misc]
    """numba's cache on disk, keyed by `_digest`; a kernel that cannot be read or written is compiled again."""

    def __init__(self, function: Callable[..., Any], compiling: Callable[[], None]) -> None:
        super().__init__(function)
        self._compiling = compiling
        # numba's own name would contain the line number
        file = Path(function.__code__.co_filename).stem
        name = f"{file}.{function.__qualname__}.{sys.implementation.cache_tag}"
        self._cache_file = _CacheFile(self._cache_path, re.sub("[<>]", "", name), _digest(function))

    def load_overload(self, sig: object, target_context: object) -> object:
        found = None
        try:
            found = self._load(sig, target_context)
        except Exception:  # noqa: BLE001 - what a damaged file raises depends on its bytes
            with suppress(OSError):  # a cache that is read-only stays damaged
                self.flush()
        if found is None:
            self._compiling()
        return found

    def _load(self, sig: object, target_context: object) -> object:
        """Load compiled code with the run-time library that it is linked with.

        numba's own `load_overload` first sets up the compiler, which takes longer than loading; compiling sets it up
        anyway.
        """
        rtsys.initialize(target_context)
        import_module("numba.cpython.hashing")  # defines a symbol that code with dictionaries needs
        return self._load_overload(sig, target_context)

    def save_overload(self, sig: object, data: object) -> None:
        # A full disk, a deleted folder, a damaged index that cannot be replaced do no harm: the kernel is in memory.
        with suppress(Exception):
            super().save_overload(sig, data)


def cached_dispatcher(function: Callable[..., Any], compiling: Callable[[], None]) -> Any:
    """numba's dispatcher of a function that Python calls: it compiles for the types of the arguments, or loads from the
    cache.

    `compiling` is called before it compiles. The GIL is released while the function runs; NaN and infinities are kept
    (no ``fastmath=True``: checks for them must work), and sums are evaluated in the order in which they are written,
    unless the kernel is `reordered`.
    """
    dispatcher = numba.njit(**OPTIONS, fastmath=_allowed(function), pipeline_class=_EntryCompiler)(function)
    if hasattr(dispatcher, "_cache"):  # NUMBA_DISABLE_JIT gives the function itself
        # Without a writable folder for the cache (read-only installation and home), every process compiles.
        with suppress(RuntimeError):
            dispatcher._cache = _KernelCache(function, compiling)
    return dispatcher
