"""Common Data Representation as ROS 2 sends it: XCDR version 1, little endian, zero padding.

A message is four bytes of encapsulation header followed by the fields in order. Every primitive is aligned to its own
size, counted from the first byte after the header. Source: OMG Data Distribution Service Interoperability Wire Protocol
2.5, section 10, and OMG CORBA 3.3 part 2, section 9.3.
"""

import struct

import numpy as np
import numpy.typing as npt

from cloth_core.errors import ClothError

__all__ = ["ENCAPSULATION", "CdrError", "CdrReader", "CdrWriter"]

ENCAPSULATION = b"\x00\x01\x00\x00"
"""Header of plain little-endian CDR; its two option bytes are zero."""


class CdrError(ClothError):
    """Bytes that are not the message that they are said to be."""


class CdrWriter:
    """Appends fields to a growing buffer and pads with zeros, so that equal messages are equal bytes."""

    def __init__(self) -> None:
        self._body = bytearray()

    def _align(self, size: int) -> None:
        self._body += bytes(-len(self._body) % size)

    def uint8(self, value: int) -> None:
        """One byte; also `bool` and `byte`."""
        self._body += struct.pack("<B", value)

    def int32(self, value: int) -> None:
        """Signed integer of four bytes."""
        self._align(4)
        self._body += struct.pack("<i", value)

    def uint32(self, value: int) -> None:
        """Unsigned integer of four bytes; also the count that precedes a sequence."""
        self._align(4)
        self._body += struct.pack("<I", value)

    def string(self, text: str) -> None:
        """Count of bytes with the closing zero, UTF-8 bytes, zero."""
        encoded = text.encode("utf-8")
        self.uint32(len(encoded) + 1)
        self._body += encoded + b"\x00"

    def array(self, values: npt.NDArray[np.generic]) -> None:
        """Elements of a fixed array or sequence in C order, without a count; no elements leave no padding either."""
        if values.size == 0:
            return
        self._align(values.dtype.itemsize)
        self._body += values.astype(values.dtype.newbyteorder("<"), copy=False).tobytes()

    def to_bytes(self) -> bytes:
        """The message with its encapsulation header."""
        return ENCAPSULATION + bytes(self._body)

    def __len__(self) -> int:
        """Bytes after the encapsulation header so far."""
        return len(self._body)


class CdrReader:
    """Reads fields in order from a message that nobody vouches for.

    Each length is compared with the bytes that are left before anything is taken, so a forged count costs nothing.

    Args:
        data: message with its encapsulation header
        what: the message's name in errors, for example ``"body message"``

    Raises:
        CdrError: here, if the header is not that of plain little-endian CDR, and in every method, if the field would
            reach beyond the last byte.
    """

    def __init__(self, data: bytes | bytearray | memoryview, what: str) -> None:
        self._what = what
        view = memoryview(data).cast("B")
        if len(view) < len(ENCAPSULATION):
            raise CdrError(f"{what}: {len(view)} bytes are too few for a message; send it as CDR")
        if view[:2] != ENCAPSULATION[:2]:
            raise CdrError(f"{what}: encapsulation {bytes(view[:2]).hex()} is not plain little-endian CDR; send 0001")
        self._body = view[len(ENCAPSULATION) :]
        self._position = 0

    @property
    def remaining(self) -> int:
        """Bytes after the last field read."""
        return len(self._body) - self._position

    def _take(self, size: int, alignment: int, field: str) -> memoryview:
        start = self._position + -self._position % alignment
        if size > len(self._body) - start:
            left = max(len(self._body) - start, 0)
            raise CdrError(f"{self._what}: {field} needs {size} bytes but only {left} are left; send the whole message")
        self._position = start + size
        return self._body[start : start + size]

    def uint8(self, field: str) -> int:
        """One byte; also `bool` and `byte`."""
        return int(self._take(1, 1, field)[0])

    def int32(self, field: str) -> int:
        """Signed integer of four bytes."""
        (value,) = struct.unpack("<i", self._take(4, 4, field))
        return int(value)

    def uint32(self, field: str) -> int:
        """Unsigned integer of four bytes."""
        (value,) = struct.unpack("<I", self._take(4, 4, field))
        return int(value)

    def string(self, field: str) -> str:
        """UTF-8 text; the count on the wire includes the closing zero."""
        count = self.uint32(f"length of {field}")
        encoded = self._take(count, 1, field)
        # Some writers send an empty string as count 0, without the closing zero.
        if count and encoded[-1] != 0:
            raise CdrError(f"{self._what}: {field} does not end with a zero byte; send it as a CDR string")
        try:
            return bytes(encoded[:-1]).decode("utf-8")
        except UnicodeDecodeError as error:
            raise CdrError(f"{self._what}: {field} is not UTF-8 at byte {error.start}; send UTF-8 text") from None

    def array(self, dtype: str, count: int, field: str) -> npt.NDArray[np.generic]:
        """`count` numbers of the little-endian `dtype` (such as ``"<f8"``) as a read-only view of the message."""
        element = np.dtype(dtype)
        if count == 0:
            return np.empty(0, dtype=element)
        return np.frombuffer(self._take(count * element.itemsize, element.itemsize, field), dtype=element)

    def end(self) -> None:
        """Checks that nothing follows. Up to three bytes are the transport's padding to a multiple of four."""
        if self.remaining > 3:
            raise CdrError(f"{self._what}: {self.remaining} bytes follow its last field; send one message of this type")
