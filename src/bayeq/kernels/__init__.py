"""Compiled functions: with `kernel` numba compiles a function when it is first called; `compiler` caches it on disk.

Importing numba, and compiling or loading a kernel, take a while: neither happens before it is needed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, update_wrapper
from typing import Any, TypeVar, cast, overload

__all__ = ["Kernel", "announce_compiling", "kernel"]

F = TypeVar("F", bound=Callable[..., Any])

# Called once, before the first kernel that is not in the cache is compiled.
_announcement: list[Callable[[], None]] = []


def announce_compiling(tell: Callable[[], None]) -> None:
    """Have `tell` called once, before the first kernel is compiled, since that takes a while."""
    _announcement[:] = [tell]


def _say_compiling() -> None:
    if _announcement:
        _announcement.pop()()


class Kernel:
    """A compiled function, called like the Python function that it was made from; kernels may call each other."""

    def __init__(self, function: Callable[..., Any]) -> None:
        update_wrapper(self, function)
        self.py_func = function  # the function itself

    @cached_property
    def dispatcher(self) -> Any:
        """numba's dispatcher, made at the first call; the kernel has its attributes too."""
        from bayeq.kernels.compiler import cached_dispatcher

        return cached_dispatcher(self.py_func, _say_compiling)

    @cached_property
    def inner(self) -> Any:
        """numba's dispatcher for kernels that call this one."""
        from bayeq.kernels.compiler import inner_dispatcher

        return inner_dispatcher(self.py_func)

    @property
    def _numba_type_(self) -> Any:
        """The numba type of this kernel in kernels that call it."""
        return self.inner._numba_type_

    def __call__(self, *arguments: Any) -> Any:
        return self.dispatcher(*arguments)

    def __reduce__(self) -> str:
        # pickled by its name, as functions are
        return self.py_func.__qualname__

    def __getattr__(self, name: str) -> Any:
        return getattr(self.dispatcher, name)


@overload
def kernel(function: F) -> F: ...
@overload
def kernel(*, reordered: bool = False, borrowing: bool = False) -> Callable[[F], F]: ...
def kernel(function: F | None = None, *, reordered: bool = False, borrowing: bool = False) -> F | Callable[[F], F]:
    """Have numba compile `function` in nopython mode when it is first called, and cache it on disk.

    With `reordered` its sums may be taken in another order and fused with products, which makes long sums many times
    as fast; NaN and infinities are still handled. A `borrowing` kernel must create no arrays or views of arrays; where
    another kernel calls it, references to its arguments are not counted, which makes short kernels twice as fast. See
    `bayeq.kernels.compiler.cached_dispatcher`.
    """

    def made(one: F) -> F:
        out = Kernel(one)
        out.py_func.__dict__.update(reordered=reordered, borrowing=borrowing)
        return cast(F, out)

    return made if function is None else made(function)
