"""A message that is encoded by whoever first wants its bytes, so that who sends it does not wait for that."""

import threading
from collections.abc import Callable

__all__ = ["DeferredMessage", "Message"]


class DeferredMessage:
    """Becomes CDR bytes once, in the thread that first takes `bytes` of it; never, if nobody does.

    Args:
        size: of the encoded message [bytes], which is also its `len` from the beginning
        encode: makes it; what this holds on to must not change any more, and is let go once it has been called
    """

    def __init__(self, size: int, encode: Callable[[], bytes]) -> None:
        self._size = size
        self._encode: Callable[[], bytes] | None = encode
        self._data = b""
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return self._size

    def __bytes__(self) -> bytes:
        with self._lock:
            if self._encode is not None:
                self._data = self._encode()
                self._encode = None
            return self._data


Message = bytes | DeferredMessage
"""CDR bytes, now or later: `bytes(message)` gives them, and of bytes themselves costs nothing."""
