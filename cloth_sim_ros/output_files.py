"""Names for new files in the one directory that a node may write to."""

import os
import re
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from cloth_core.errors import ClothError
from cloth_sim_ros.log_writer import LogExistsError

__all__ = ["claim_path", "free_path"]

LONGEST_NAME = 64
MOST_ATTEMPTS = 1000


def claim_path(
    directory: str | os.PathLike[str], name: str, suffixes: Sequence[str], claim: Callable[[Path], object]
) -> Path:
    """A free path that nobody else has taken meanwhile, in this process or in another.

    Args:
        directory, name, suffixes: as of `free_path`
        claim: makes a file of the path, without its suffix, and raises FileExistsError or LogExistsError if somebody
            was quicker

    Raises:
        ClothError: what `free_path` and `claim` raise, or all names are taken.
    """
    for _ in range(MOST_ATTEMPTS):
        path = free_path(directory, name, suffixes)
        try:
            claim(path)
        except (FileExistsError, LogExistsError):
            continue
        return path
    raise ClothError(f"record_directory '{directory}': no name is free for '{path.name}'; set it to another directory")


def free_path(directory: str | os.PathLike[str], name: str, suffixes: Sequence[str]) -> Path:
    """Path without suffix, ``<name>_<date>_<time>[_<number>]``, of which no file with one of the suffixes exists yet.

    Whatever `name` holds, the path lies directly in `directory`, which is made if need be.

    Raises:
        ClothError: the directory cannot be made or looked into.
    """
    safe_name = re.sub(r"[^A-Za-z0-9_-]+", "_", name)[:LONGEST_NAME].strip("_") or "garment"
    stem = f"{safe_name}_{time.strftime('%Y%m%d_%H%M%S')}"
    folder = Path(directory)
    number = 1
    path = folder / stem
    try:
        folder.mkdir(parents=True, exist_ok=True)
        while any(os.path.lexists(f"{path}{suffix}") for suffix in suffixes):
            number += 1
            path = folder / f"{stem}_{number}"
    except OSError as error:
        raise ClothError(
            f"record_directory '{folder}': {error.strerror}; set it to a directory that can be written"
        ) from None
    return path
