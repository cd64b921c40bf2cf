"""How all compiled functions are compiled: cached, without the GIL, division by zero gives inf as in NumPy.

Numba keeps a cached function until its own file changes, although it holds compiled copies of what it calls in other
files; after an update that would run old code on new arrays. So the cache of each module lies in a directory named
after the content of that module and of all modules of the package that it imports, directly or not.

Compiling takes a second for each function and each combination of argument types, so functions are called with the same
ones wherever that is possible: with arrays in one layout that can be written to, and `zero()` where a count begins,
since a literal 0 is a type of its own.

Numba counts references to arrays, atomically, for each row x[i] that is passed on and each call that takes arrays: that
was a sixth of all processor time of scenes with contact. What makes no arrays need not count, and so most kernels
borrow those of their callers, who make them in Python.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np

__all__ = ["borrowing_kernel", "cache_directory", "inlined_kernel", "kernel", "zero"]

F = TypeVar("F", bound=Callable[..., Any])

_config: Any = numba.config
_njit: Any = numba.njit
# No option that Numba documents: where there is none, references are counted. It has to be given in any case, since
# otherwise what is called for the first time is compiled as its caller is.
_CAN_DO_WITHOUT_COUNTING = hasattr(numba.core.options.DefaultOptions, "_nrt")

_IMPORT = re.compile(r"^\s*from cloth_core\.(\w+) import", re.MULTILINE)


@cache
def cache_directory(module: str) -> Path:
    """Where the compiled functions of a module (`cloth_core.springs`) are kept.

    Below NUMBA_CACHE_DIR, else below the user's cache directory.
    """
    digest = hashlib.sha256(numba.__version__.encode())
    folder = Path(__file__).parent
    waiting, sources = [module.rpartition(".")[2], "kernel"], {}
    while waiting:
        name = waiting.pop()
        source = folder / f"{name}.py"
        if name not in sources and source.exists():
            sources[name] = source.read_text(encoding="utf-8")
            waiting += _IMPORT.findall(sources[name])
    for name in sorted(sources):
        digest.update(f"{name}\n{sources[name]}".encode())
    user = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(_config.CACHE_DIR or Path(user) / "cloth_core") / digest.hexdigest()[:16]


def kernel(function: F) -> F:
    """Compile a function at its first call."""
    return _compiled(function, inline="never")


def borrowing_kernel(function: F) -> F:
    """Compile a function that makes no arrays and returns none, at its first call: it counts no references."""
    return _compiled(function, inline="never", counts_references=False)


def inlined_kernel(function: F) -> F:
    """Compile a small function into its callers."""
    return _compiled(function, inline="always")


def _compiled(function: F, inline: str, counts_references: bool = True) -> F:
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "inline": inline}
    if _CAN_DO_WITHOUT_COUNTING:
        options["_nrt"] = counts_references
    # The place is read when the function is decorated; other packages' functions keep theirs.
    before = _config.CACHE_DIR
    _config.CACHE_DIR = str(cache_directory(function.__module__))
    try:
        return cast(F, _njit(cache=True, **options)(function))
    except (RuntimeError, OSError):  # no directory can be written to: compile anew in each process
        return cast(F, _njit(**options)(function))
    finally:
        _config.CACHE_DIR = before


@inlined_kernel
def zero() -> int:
    """0 as an int64 and not as a literal."""
    return np.int64(0)  # type: ignore[return-value]
