"""How numba compiles kernels: one that is called from Python once, together with all that it calls.

By itself numba makes every kernel callable from Python and C, and optimises and translates each with all that it calls,
so that a kernel three calls down is translated three times and more, and most of the result is never called. Here
kernels that are called by kernels stay unoptimised LLVM code until they are linked into the one that Python calls.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import llvmlite.binding as llvm
import numba
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler

__all__ = ["entry_dispatcher", "inner_dispatcher", "options_of"]

OPTIONS = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}


class _EntryLibrary(JITCodeLibrary):  # type: ignore[misc]
    """LLVM code of a kernel that Python calls, with all that it calls."""

    def serialize_using_object_code(self) -> tuple[str, str, tuple[bytes, bytes]]:
        """Machine code and, in place of the LLVM code, the names that it defines, which numba looks for on loading.

        The LLVM code would be parsed at every start, for callers among the kernels: these have an `_InnerLibrary`.
        """
        functions = [f for f in self._final_module.functions if not f.is_declaration]
        names = [f.name for f in functions if f.linkage == llvm.Linkage.external]
        stub = llvm.parse_assembly("\n".join(f'define void @"{name}"() {{ ret void }}' for name in names))
        return self.name, "object", (self._get_compiled_object(), stub.as_bitcode())


class _InnerLibrary(_EntryLibrary):
    """LLVM code of a kernel that kernels call: it is optimised and becomes machine code as part of these."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """No machine code, no pointer."""
        self._ensure_finalized()
        return 0

    @property
    def codegen(self) -> Any:
        """What `set_env` is called on."""
        return self

    def set_env(self, name: str, env: object) -> None:
        """Machine code would hold a pointer to its Python environment."""


class _EntryCompiler(Compiler):  # type: ignore[misc]
    library = _EntryLibrary

    def define_pipelines(self) -> Any:
        state = self.state
        state.library = self.library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return super().define_pipelines()


class _InnerCompiler(_EntryCompiler):
    library = _InnerLibrary


def options_of(function: Callable[..., Any]) -> dict[str, bool]:
    """The options with which `bayeq.kernels.kernel` marked a function."""
    return {name: bool(getattr(function, name, False)) for name in ("reordered", "borrowing")}


def entry_dispatcher(function: Callable[..., Any]) -> Any:
    """numba's dispatcher of a function that Python calls.

    The GIL is released while it runs; NaN and infinities stay what they are (no ``fastmath=True``: checks for them must
    work), and sums are in the order in which they are written, if the kernel does not allow another.
    """
    return numba.njit(**OPTIONS, fastmath=_allowed(function), pipeline_class=_EntryCompiler)(function)


def inner_dispatcher(function: Callable[..., Any]) -> Any:
    """numba's dispatcher of a function that kernels call.

    A borrowing one has no part in numba's memory management (``_nrt``): its arrays live as long as its caller's.
    """
    options = {**OPTIONS, "fastmath": _allowed(function), "_nrt": not options_of(function)["borrowing"]}
    return numba.njit(**options, no_cpython_wrapper=True, pipeline_class=_InnerCompiler)(function)


def _allowed(function: Callable[..., Any]) -> set[str] | bool:
    """LLVM's flags."""
    return {"reassoc", "contract"} if options_of(function)["reordered"] else False
