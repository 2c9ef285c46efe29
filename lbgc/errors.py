"""Errors in a user's input, InputError, and the typed configuration that raises it."""

import dataclasses
import sys
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

from lbgc.outputs import LONGEST, shown
from lbgc.units import unit_of

Config = TypeVar("Config")

_LARGEST = 1e30
"""Size beyond which no number is taken: squares and products of a few stay numbers."""
_MOST = 2**63
"""Whole numbers are less, so that every array can hold them."""
_LONGEST = 300
"""Largest number of characters that are shown of another parser's message, or of a value."""
_LONGEST_CHOICES = 4000
"""Largest number of characters that are shown of what a value could be."""

Axes = float | list[float]
"""A configured value for all three axes, or one for each (forward, right, down)."""

Spread = float | tuple[float, ...]
"""A configured value, or the [low, high] from which each recording draws its own, uniformly."""


class InputError(ValueError):
    """The user's input is wrong: which parameter, its value and unit, and what it could be."""

    def __init__(self, name: str, value: Any, unit: str = "", choices: str | Sequence[str] = ""):
        self.name, self.value, self.unit, self.choices = name, value, unit, choices
        super().__init__(name, value, unit, choices)

    def __str__(self) -> str:
        choices = self.choices
        if not isinstance(choices, str):
            choices = "choose from " + ", ".join(map(shown, choices))
        unit = f" {self.unit}" if self.unit else ""
        said = f"{shown(self.name)} = {shown(self.value, _LONGEST)}{unit}"
        return f"{said}: {shown(choices, _LONGEST_CHOICES)}" if choices else said

    def within(self, prefix: str) -> "InputError":
        """This error with its parameter's name prefixed by the group that holds it."""
        return InputError(f"{prefix}.{self.name}", self.value, self.unit, self.choices)


def require(condition: bool, name: str, value: Any, choices: str | Sequence[str]) -> None:
    """Raise InputError unless the condition holds. The unit is taken from the parameter's name."""
    if not condition:
        raise InputError(name, value, unit_of(name), choices)


@contextmanager
def reading(name: str, value: Any, what: str = "cannot be read") -> Iterator[None]:
    """Turn any exception inside the `with` block into InputError on this parameter. It is meant for
    calls of other people's parsers on files from outside, which may be anything, and for nothing
    else. what : what the error says of the file."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        why = " ".join(str(error).split())[:_LONGEST] or type(error).__name__
        raise InputError(name, value, "", f"{what} ({why})") from error


def require_choice(name: str, value: str, choices: Sequence[str]) -> None:
    """Raise InputError unless the value is one of the choices."""
    require(value in choices, name, value, choices)


def require_name(name: str, value: str) -> None:
    """Raise InputError unless a text can stand for something in tables: on one line, not long, and
    of characters that are seen."""
    good = 0 < len(value) <= LONGEST // 2 and shown(value) == value == value.strip()
    require(good, name, value, f"must be a name of up to {LONGEST // 2} printable characters")


def require_positive(name: str, value: float | None) -> None:
    """Raise InputError unless the value is greater than zero, or None: not given."""
    require(value is None or value > 0, name, value, "must be greater than zero")


def require_not_negative(config: Any, *names: str) -> None:
    """Raise InputError unless every named field of a dataclass (a number, or one an axis) is zero
    or more."""
    for name in names:
        value = getattr(config, name)
        lowest = min(value) if isinstance(value, list | tuple) else value
        require(lowest >= 0, name, value, "must not be negative")


def require_spread(config: Any, *names: str, least: float = 0.0) -> None:
    """Raise InputError unless every named field is a number, or [low, high], and not below
    `least`."""
    for name in names:
        value = getattr(config, name)
        ends = value if isinstance(value, tuple) else (value, value)
        ordered = len(ends) == 2 and ends[0] <= ends[1]
        require(ordered, name, value, "must be a number, or [low, high] to draw from")
        require(ends[0] >= least, name, value, f"must be {least:g} or more")


def build(cls: type[Config], mapping: Mapping[str, Any]) -> Config:
    """A frozen configuration dataclass from the values of YAML and the command line.

    Types are checked against the annotations, numbers must be finite, unknown keys are refused.

    Raises InputError, naming the parameter by its full key.
    """
    adopted = getattr(cls, "adopted", None)
    if adopted is not None:  # other names of its keys are translated first
        mapping = adopted(mapping)
    hints = typing.get_type_hints(cls)
    fields = {f.name: f for f in dataclasses.fields(cls)}  # type: ignore[arg-type]
    for key in mapping:
        require_choice("key", str(key), list(fields))
    for name, field in fields.items():
        has_default = (field.default, field.default_factory) != (dataclasses.MISSING,) * 2
        require(name in mapping or has_default, name, "(missing)", "must be given")
    return cls(**{key: _convert(hints[key], key, value) for key, value in mapping.items()})


def _convert(annotation: Any, name: str, value: Any) -> Any:
    """A value as the type that an annotation states. Raises InputError where it is of another."""
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        options = typing.get_args(annotation)
        if value is None and type(None) in options:
            return None
        is_list = isinstance(value, list | tuple)
        for option in options:
            takes_list = typing.get_origin(option) in (list, tuple)
            if takes_list == is_list and option is not type(None):
                return _convert(option, name, value)
        raise InputError(name, value, unit_of(name), f"must be {_type_in_words(annotation)}")
    if dataclasses.is_dataclass(annotation):
        if not isinstance(value, Mapping):
            raise InputError(name, value, "", "must be a group of parameters")
        try:
            return build(annotation, value)  # type: ignore[arg-type]
        except InputError as error:
            raise error.within(name) from None
    kind = typing.get_origin(annotation)
    if kind in (list, tuple) and isinstance(value, list | tuple):
        return kind(_convert(typing.get_args(annotation)[0], name, v) for v in value)
    if annotation is float and isinstance(value, int | float) and not isinstance(value, bool):
        # An int is never infinite, but may exceed the largest float.
        require(abs(value) <= sys.float_info.max, name, value, "must be a finite number")
        good = value == 0 or 1 / _LARGEST <= abs(value) <= _LARGEST
        require(good, name, value, f"must be 0, or from {1 / _LARGEST:g} to {_LARGEST:g} in size")
        return float(value)
    if annotation is int and type(value) is int:
        require(abs(value) < _MOST, name, value, "must be less than 2^63")
        return value
    if annotation in (str, bool) and type(value) is annotation:
        return value
    if annotation is Any:
        return value
    raise InputError(name, value, unit_of(name), f"must be {_type_in_words(annotation)}")


def _type_in_words(annotation: Any) -> str:
    """A type in words."""
    words = {float: "a number", int: "a whole number", str: "a text", bool: "true or false"}
    if annotation is type(None):
        return "null"
    if typing.get_origin(annotation) in (list, tuple):
        return f"a list [...] of which each is {_type_in_words(typing.get_args(annotation)[0])}"
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return " or ".join(_type_in_words(option) for option in typing.get_args(annotation))
    return words.get(annotation, "a group of parameters")
