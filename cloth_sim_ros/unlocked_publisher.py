"""Publishing that other Python threads do not wait for.

rclpy keeps Python's lock while rcl publishes or looks for acknowledgements, and both may wait for a lock of DDS for as
long as it is held up by a subscriber; then no service would answer. ctypes gives the lock away for each call.
"""

import ctypes

from rclpy.duration import Duration
from rclpy.publisher import Publisher

__all__ = ["UnlockedPublisher"]

_RCL_RET_OK, _RCL_RET_TIMEOUT = 0, 2


class _SerializedMessage(ctypes.Structure):
    """`rcl_serialized_message_t`: `rcutils_uint8_array_t` with its allocator, which publishing does not use."""

    _fields_ = (
        ("buffer", ctypes.c_char_p),
        ("buffer_length", ctypes.c_size_t),
        ("buffer_capacity", ctypes.c_size_t),
        ("allocator", ctypes.c_void_p * 5),
    )


class UnlockedPublisher:
    """The part of `rclpy.publisher.Publisher` that sends, without Python's lock.

    Args:
        publisher: must not be destroyed while this is in use

    Raises:
        OSError: librcl is not where rclpy has it from
    """

    def __init__(self, publisher: Publisher) -> None:
        rcl = ctypes.CDLL("librcl.so")
        self._publish = rcl.rcl_publish_serialized_message
        self._publish.argtypes = [ctypes.c_void_p, ctypes.POINTER(_SerializedMessage), ctypes.c_void_p]
        self._wait = rcl.rcl_publisher_wait_for_all_acked
        self._wait.argtypes = [ctypes.c_void_p, ctypes.c_int64]
        self._forget_error = ctypes.CDLL("librcutils.so").rcutils_reset_error
        self._publisher = publisher

    def publish(self, data: bytes) -> None:
        """Publishes CDR bytes.

        Raises:
            RuntimeError: rcl refuses, as after the context has been shut down
        """
        message = _SerializedMessage(data, len(data), len(data))
        with self._publisher.handle:
            code = self._publish(self._publisher.handle.pointer, message, None)
        self._check(code, "publish")

    def wait_for_all_acked(self, timeout: Duration) -> bool:
        """Whether all subscribers have acknowledged all that was published, at the latest after this time.

        Raises:
            RuntimeError: rcl refuses
        """
        with self._publisher.handle:
            code = self._wait(self._publisher.handle.pointer, timeout.nanoseconds)
        if code == _RCL_RET_TIMEOUT:
            self._forget_error()
            return False
        self._check(code, "wait for acknowledgements")
        return True

    def _check(self, code: int, what: str) -> None:
        if code != _RCL_RET_OK:
            self._forget_error()
            raise RuntimeError(f"rcl error {code}; cannot {what}")
