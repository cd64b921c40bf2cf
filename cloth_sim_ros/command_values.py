"""Kinds of values that the command line takes."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

__all__ = ["OutputFile", "PictureSize", "Quantity"]

LEAST_PIXELS, MOST_PIXELS = 120, 16384


class Quantity(click.ParamType):  # type: ignore[type-arg]  # generic in the newest Click only
    """A finite number with a unit, at or (if `above`) above `minimum`."""

    def __init__(self, unit: str, minimum: float = 0.0, *, above: bool = False) -> None:
        self.name = unit
        self._minimum = minimum
        self._above = above

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        """The unit as it is written; Click would put it in capitals."""
        return self.name

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number, or a usage error."""
        try:
            number = float(value)
        except ValueError:
            self.fail(f"'{value}' is not a number", param, ctx)
        if not math.isfinite(number) or number < self._minimum or (self._above and number == self._minimum):
            bound = "above" if self._above else "of at least"
            self.fail(f"{value} is not a finite number {bound} {self._minimum:g} ({self.name})", param, ctx)
        return number


class PictureSize(click.ParamType):  # type: ignore[type-arg]  # generic in the newest Click only
    """Width and height of a picture."""

    name = "WIDTHxHEIGHT"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Both in pixels, or a usage error."""
        width, _, height = str(value).lower().partition("x")
        try:
            size = int(width), int(height)
        except ValueError:
            self.fail(f"'{value}' is not a size; write it like 1600x1000", param, ctx)
        if not LEAST_PIXELS <= min(size) <= max(size) <= MOST_PIXELS:
            self.fail(f"'{value}': use {LEAST_PIXELS} to {MOST_PIXELS} pixels each way", param, ctx)
        return size


class OutputFile(click.ParamType):  # type: ignore[type-arg]  # generic in the newest Click only
    """A file that can be written, with one of the suffixes: known before a long run, not after it."""

    name = "FILE"

    def __init__(self, suffixes: Sequence[str]) -> None:
        self._suffixes = tuple(suffixes)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The path, or a usage error."""
        path = Path(value)
        if path.suffix.lower() not in self._suffixes:
            self.fail(f"'{path}' must end in {' or '.join(self._suffixes)}", param, ctx)
        if not path.parent.is_dir():
            self.fail(f"'{path}': there is no directory '{path.parent}'; make it first", param, ctx)
        if path.is_dir():
            self.fail(f"'{path}' is a directory; name a file", param, ctx)
        if not os.access(path if path.exists() else path.parent, os.W_OK):
            self.fail(f"'{path}' cannot be written; choose another place", param, ctx)
        return path
