"""``kernel``: numba compilation with a cache that follows callees.

numba's own file cache looks only at the file of the function itself, so that an edited callee in another
file leaves a stale caller behind. Here the key of a kernel is a digest of its code, of the global constants
it uses, of the layout of the NamedTuples it takes and, recursively, of the kernels it calls: whatever changes
the result changes the key.
"""

from __future__ import annotations

import dis
import hashlib
import marshal
import sys
from collections.abc import Callable
from types import CodeType, ModuleType
from typing import Any, TypeGuard, TypeVar

import numba
import numpy as np
from numba.core import caching

__all__ = ["announce_compiling", "kernel", "kernel_digest"]

F = TypeVar("F", bound=Callable[..., Any])


def _bare(code: CodeType) -> bytes:
    """Bytes of a code object without its file name, line numbers and comments."""
    consts = tuple(_bare(c) if isinstance(c, CodeType) else c for c in code.co_consts)
    return marshal.dumps((code.co_code, consts, code.co_names, code.co_varnames, code.co_freevars))


def _global_names(code: CodeType) -> set[str]:
    return {i.argval for i in dis.get_instructions(code) if i.opname == "LOAD_GLOBAL"}


def _layout(cls: type) -> str:
    """Fields of a NamedTuple, in order, with those of the NamedTuples among them."""
    space = vars(sys.modules[cls.__module__])
    fields = []
    for name, annotation in cls.__annotations__.items():
        inner = annotation if isinstance(annotation, type) else space.get(str(annotation))
        fields.append(f"{name}:{_layout(inner) if _is_record(inner) else annotation}")
    return f"{cls.__name__}({','.join(fields)})"


def _is_record(value: object) -> TypeGuard[type]:
    return isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_fields")


def kernel_digest(function: Callable[..., Any]) -> str:
    """Digest of a function's code, the constants it reads, the records it takes and the kernels it calls."""
    function = getattr(function, "py_func", function)
    seen: set[int] = set()
    sha = hashlib.sha256()

    def visit(f: Callable[..., Any]) -> None:
        if id(f) in seen:
            return
        seen.add(id(f))
        sha.update(_bare(f.__code__))
        sha.update(repr(f.__defaults__).encode())
        for annotation in f.__annotations__.values():
            record = annotation if isinstance(annotation, type) else f.__globals__.get(str(annotation))
            if _is_record(record):
                sha.update(_layout(record).encode())
        for name in sorted(_global_names(f.__code__)):
            value = f.__globals__.get(name)
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


class _DigestStamp:
    """Mixin for numba's cache locators: the stamp is the kernel's digest instead of its file's age."""

    _function: Callable[..., Any]

    def __init__(self, py_func: Callable[..., Any], py_file: str) -> None:
        super().__init__(py_func, py_file)  # type: ignore[call-arg]
        self._function = py_func

    def get_source_stamp(self) -> str:
        return kernel_digest(self._function)

    def get_disambiguator(self) -> str:
        return "kernel"


class _Chosen(_DigestStamp, caching.UserProvidedCacheLocator):  # type: ignore[misc]
    pass


class _InTree(_DigestStamp, caching.InTreeCacheLocator):  # type: ignore[misc]
    pass


class _UserWide(_DigestStamp, caching.UserWideCacheLocator):  # type: ignore[misc]
    pass


class _KernelCacheImpl(caching.CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (_Chosen, _InTree, _UserWide)


# Called once, before the first kernel that is not in the cache is compiled.
_announcement: list[Callable[[], None]] = []


def announce_compiling(tell: Callable[[], None]) -> None:
    """Have somebody told, once, that kernels are about to be compiled: it takes a while."""
    _announcement[:] = [tell]


class _KernelCache(caching.FunctionCache):  # type: ignore[misc]
    _impl_class = _KernelCacheImpl

    def load_overload(self, sig: object, target_context: object) -> object:
        found = super().load_overload(sig, target_context)
        if found is None and _announcement:
            _announcement.pop()()
        return found


def kernel(function: F) -> F:
    """Compile `function` with numba in nopython mode and cache it on disk, keyed by `kernel_digest`.

    Callees must be defined above their callers, so that the digest sees them. The GIL is released while a
    kernel runs; floating-point semantics stay strict (no ``fastmath``: NaN checks must work).
    """
    dispatcher = numba.njit(nogil=True, error_model="numpy")(function)
    try:
        dispatcher._cache = _KernelCache(function)
    except RuntimeError:
        # Nowhere to write a cache (read-only installation and home): compile in every process.
        return dispatcher
    return dispatcher
