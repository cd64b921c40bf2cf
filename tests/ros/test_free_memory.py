"""What is free goes back to the system."""

import subprocess
import sys

import pytest

# Pairs of blocks below the size that is mapped by itself, of which the upper one stays and pins the heap's end.
PROGRAM = """
import ctypes, os
from cloth_sim_ros.free_memory import give_back_free_memory
libc = ctypes.CDLL(None)
libc.malloc.restype, libc.malloc.argtypes, libc.free.argtypes = ctypes.c_void_p, [ctypes.c_size_t], [ctypes.c_void_p]
page = os.sysconf("SC_PAGE_SIZE")
resident = lambda: int(open("/proc/self/statm").read().split()[1]) * page
blocks = [libc.malloc(100_000) for _ in range(1000)]
for block in blocks:
    ctypes.memset(block, 1, 100_000)
for block in blocks[:-1]:
    libc.free(block)
before = resident()
give_back_free_memory()
print(before - resident())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="asks the C library of GNU")
def test_freed_memory_below_some_that_is_in_use_is_given_back():
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    assert int(done.stdout) > 80_000_000
