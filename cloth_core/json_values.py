"""Values of a JSON document with their type, count and size checked; each error names where in the document it is."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import islice
from math import isfinite
from typing import Any

from cloth_core.errors import PatternError

__all__ = [
    "MAX_NAME_LENGTH",
    "MAX_NUMBER",
    "json_label",
    "json_list",
    "json_number",
    "json_numbers",
    "json_object",
    "kind_of",
    "listed",
    "required",
    "shown",
]

MAX_NAME_LENGTH = 200
MAX_NUMBER = 1e9


def json_object(value: Any, where: str) -> dict[str, Any]:
    """The value, which must be an object."""
    if not isinstance(value, dict):
        raise PatternError(f"{where}: expected an object {{...}}, found {kind_of(value)}")
    return value


def json_list(value: Any, where: str, count: int | None = None) -> list[Any]:
    """The value, which must be a list, of `count` entries if that is given."""
    if not isinstance(value, list):
        raise PatternError(f"{where}: expected a list [...], found {kind_of(value)}")
    if count is not None and len(value) != count:
        raise PatternError(f"{where}: expected {count} value{'s' * (count != 1)}, found {len(value)}")
    return value


def required(mapping: Mapping[str, Any], key: str, where: str) -> Any:
    """The value of a key that must be there."""
    if key not in mapping:
        raise PatternError(f"{where}: the key {key!r} is missing; add it")
    return mapping[key]


def json_number(value: Any, where: str) -> float:
    """The value, which must be a finite number (true and false are none) of at most MAX_NUMBER."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise PatternError(f"{where}: expected a number, found {kind_of(value)}")
    if isinstance(value, float) and not isfinite(value):
        raise PatternError(f"{where}: {value} is not a finite number; correct it")
    if abs(value) > MAX_NUMBER:
        raise PatternError(f"{where}: {shown(value)} is too large for a pattern; correct it")
    return float(value)


def json_numbers(value: Any, count: int, where: str) -> tuple[float, ...]:
    """The value, which must be a list of `count` numbers."""
    return tuple(json_number(number, where) for number in json_list(value, where, count))


def json_label(spec: Mapping[str, Any], where: str) -> str | None:
    """The optional text under `label`; None if it is missing or empty."""
    label = spec.get("label")
    if label is not None and (not isinstance(label, str) or len(label) > MAX_NAME_LENGTH or not label.isprintable()):
        raise PatternError(
            f"{where}, label: expected a text of at most {MAX_NAME_LENGTH} printable characters, found {shown(label)}"
        )
    return label or None


def kind_of(value: Any) -> str:
    """The JSON type of a value, for a message."""
    names = {
        dict: "an object",
        list: "a list",
        str: "a text",
        bool: "true or false",
        int: "a number",
        float: "a number",
        type(None): "null",
    }
    return names.get(type(value), f"a {type(value).__name__}")


def shown(value: Any) -> str:
    """The value for a message: on one line, and short."""
    if isinstance(value, int) and abs(value) > 10**30:
        return "a number of more than 30 digits"
    if isinstance(value, (dict, list)):
        return kind_of(value)
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def listed(names: Iterable[str | int]) -> str:
    """Names for a message, the first dozen of them."""
    first = [repr(name) for name in islice(names, 13)]
    return ", ".join(first[:12]) + (", ..." if len(first) > 12 else "")
