"""How all compiled functions are compiled: cached, without the GIL, division by zero gives inf as in NumPy."""

from numba import njit

__all__ = ["inlined_kernel", "kernel"]

kernel = njit(cache=True, nogil=True, error_model="numpy")
inlined_kernel = njit(cache=True, nogil=True, error_model="numpy", inline="always")
