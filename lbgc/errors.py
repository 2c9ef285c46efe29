"""What a user can get wrong, said once: InputError, and the typed configuration."""

import dataclasses
import sys
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

from lbgc.outputs import printable
from lbgc.units import unit_of

Config = TypeVar("Config")

_LONGEST = 300
"""Characters that are shown of another parser's message, at most."""

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
            choices = "choose from " + ", ".join(map(str, choices))
        shown = f"{self.name} = {self.value}" + (f" {self.unit}" if self.unit else "")
        return printable(f"{shown}: {choices}" if choices else shown)

    def within(self, prefix: str) -> "InputError":
        """This error with its parameter named from one level further out."""
        return InputError(f"{prefix}.{self.name}", self.value, self.unit, self.choices)


def require(condition: bool, name: str, value: Any, choices: str | Sequence[str]) -> None:
    """Raise InputError unless the condition holds; the unit is read off the parameter's name."""
    if not condition:
        raise InputError(name, value, unit_of(name), choices)


@contextmanager
def reading(name: str, value: Any, what: str = "cannot be read") -> Iterator[None]:
    """Whatever another's parser raises on what it is given is said as InputError: an outside file
    may be anything. For calls of such parsers, and nothing else."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        why = " ".join(str(error).split())[:_LONGEST] or type(error).__name__
        raise InputError(name, value, "", f"{what} ({why})") from error


def require_choice(name: str, value: str, choices: Sequence[str]) -> None:
    require(value in choices, name, value, choices)


def require_positive(name: str, value: float | None) -> None:
    """None stands for what is not given."""
    require(value is None or value > 0, name, value, "must be greater than zero")


def require_not_negative(config: Any, *names: str) -> None:
    """Every named field of a dataclass (a number, or one an axis) must be zero or more."""
    for name in names:
        value = getattr(config, name)
        lowest = min(value) if isinstance(value, list | tuple) else value
        require(lowest >= 0, name, value, "must not be negative")


def require_spread(config: Any, *names: str, least: float = 0.0) -> None:
    """Every named field must be a number, or [low, high], not below `least`."""
    for name in names:
        value = getattr(config, name)
        ends = value if isinstance(value, tuple) else (value, value)
        ordered = len(ends) == 2 and ends[0] <= ends[1]
        require(ordered, name, value, "must be a number, or [low, high] to draw from")
        require(ends[0] >= least, name, value, f"must be {least:g} or more")


def build(cls: type[Config], mapping: Mapping[str, Any]) -> Config:
    """A frozen configuration dataclass from what YAML and the command line gave.

    Types are checked against the annotations, numbers must be finite, unknown keys are refused.

    Raises InputError, naming the parameter by its full key.
    """
    adopted = getattr(cls, "adopted", None)
    if adopted is not None:  # other people's names for what it holds
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
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        options = typing.get_args(annotation)
        if value is None and type(None) in options:
            return None
        is_list = isinstance(value, list | tuple)
        for option in options:
            takes_list = typing.get_origin(option) in (list, tuple)
            if takes_list == is_list and option is not type(None):
                return _convert(option, name, value)
        raise InputError(name, value, unit_of(name), f"must be {_spelled(annotation)}")
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
        # no int is infinite, but one may be more than a float can be
        require(abs(value) <= sys.float_info.max, name, value, "must be a finite number")
        return float(value)
    if annotation in (int, str, bool) and type(value) is annotation:
        return value
    if annotation is Any:
        return value
    raise InputError(name, value, unit_of(name), f"must be {_spelled(annotation)}")


def _spelled(annotation: Any) -> str:
    words = {float: "a number", int: "a whole number", str: "a text", bool: "true or false"}
    if annotation is type(None):
        return "null"
    if typing.get_origin(annotation) in (list, tuple):
        return f"a list [...] of which each is {_spelled(typing.get_args(annotation)[0])}"
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return " or ".join(_spelled(option) for option in typing.get_args(annotation))
    return words.get(annotation, "a group of parameters")
