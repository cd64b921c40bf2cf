"""Publishing while other Python threads run.

rclpy keeps Python's lock while rcl publishes or looks for acknowledgements: half a millisecond for a frame of 20,000
triangles, which it also copies once more, and longer where DDS is held up by a subscriber. ctypes gives the lock away
for each call.
"""

import ctypes
import os
from functools import cache
from typing import Any, Protocol

from rclpy._rclpy_pybind11 import RCLError
from rclpy.duration import Duration
from rclpy.logging import get_logger
from rclpy.publisher import Publisher

__all__ = ["Outgoing", "UnlockedPublisher", "unlocked"]

# rcl/types.h
_RCL_RET_OK, _RCL_RET_TIMEOUT = 0, 2


class Outgoing(Protocol):
    """What `Publisher` of rclpy and `UnlockedPublisher` have in common.

    Raises:
        RCLError: in every method, if rcl refuses, as after the context has been shut down
        InvalidHandle: likewise, if the publisher has been destroyed
    """

    def publish(self, data: bytes) -> None:
        """Hands CDR bytes to DDS."""

    def wait_for_all_acked(self, timeout: Duration) -> bool:
        """Whether all subscribers have acknowledged all that was published, at the latest after this time."""


class _Allocator(ctypes.Structure):
    """`rcutils_allocator_t` of rcutils/allocator.h, of which publishing makes no use."""

    _fields_ = tuple(
        (name, ctypes.c_void_p) for name in ("allocate", "deallocate", "reallocate", "zero_allocate", "state")
    )


class _SerializedMessage(ctypes.Structure):
    """`rcl_serialized_message_t`, which is `rcutils_uint8_array_t` of rcutils/types/uint8_array.h."""

    _fields_ = (
        ("buffer", ctypes.c_char_p),
        ("buffer_length", ctypes.c_size_t),
        ("buffer_capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    )


class _Rcl:
    """Functions of the very libraries that rclpy has loaded.

    Raises:
        OSError: they are loaded by other names, or as parts of others
        AttributeError: they have no such functions
    """

    def __init__(self) -> None:
        rcl, rcutils = (
            ctypes.CDLL(name, mode=os.RTLD_NOLOAD | os.RTLD_LAZY) for name in ("librcl.so", "librcutils.so")
        )
        # rcl/publisher.h
        self.publish = rcl.rcl_publish_serialized_message
        self.publish.argtypes = [ctypes.c_void_p, ctypes.POINTER(_SerializedMessage), ctypes.c_void_p]
        self.publish.restype = ctypes.c_int32
        self.wait = rcl.rcl_publisher_wait_for_all_acked
        self.wait.argtypes = [ctypes.c_void_p, ctypes.c_int64]
        self.wait.restype = ctypes.c_int32
        # rcutils/error_handling.h: the state of this thread, or none; the text is its first field.
        self.error = rcutils.rcutils_get_error_state
        self.error.argtypes = []
        self.error.restype = ctypes.c_char_p
        self.forget_error = rcutils.rcutils_reset_error
        self.forget_error.argtypes = []
        self.forget_error.restype = None


@cache
def _rcl() -> _Rcl | None:
    try:
        return _Rcl()
    except (OSError, AttributeError) as error:
        get_logger("cloth_sim_ros").debug(f"publishing keeps Python's lock: {error}")
        return None


def unlocked(publisher: Publisher) -> Outgoing:
    """The publisher without Python's lock; the publisher itself where rcl is not to be reached past rclpy."""
    rcl = _rcl()
    return publisher if rcl is None else UnlockedPublisher(publisher, rcl)


class UnlockedPublisher:
    """The part of `rclpy.publisher.Publisher` that sends, without Python's lock; `unlocked` makes it.

    Any thread may call. A publisher that is destroyed meanwhile lives on until the call returns.
    """

    def __init__(self, publisher: Publisher, rcl: _Rcl) -> None:
        self._handle: Any = publisher.handle
        self._rcl = rcl

    def publish(self, data: bytes) -> None:
        """Publishes CDR bytes as they are."""
        message = _SerializedMessage(data, len(data), len(data))
        with self._handle:
            code = self._rcl.publish(self._handle.pointer, message, None)
        self._check(code, "Failed to publish")

    def wait_for_all_acked(self, timeout: Duration) -> bool:
        """Whether all subscribers have acknowledged all that was published, at the latest after this time."""
        with self._handle:
            code = self._rcl.wait(self._handle.pointer, timeout.nanoseconds)
        if code == _RCL_RET_TIMEOUT:
            self._rcl.forget_error()
            return False
        self._check(code, "Failed to wait for all acknowledgements")
        return True

    def _check(self, code: int, failure: str) -> None:
        """Raises what rclpy would."""
        if code != _RCL_RET_OK:
            reason = (self._rcl.error() or b"no reason given").decode("utf-8", "replace")
            self._rcl.forget_error()
            raise RCLError(f"{failure}: {reason} (rcl error {code})")
