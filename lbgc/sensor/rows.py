"""A row of the one table of datasheet keys: which part of a sensor's model a key is.

The table is `GyroConfig` and `AccelConfig` themselves: a field's name ends in its unit, its default
and its docstring stand beside it, and `figure` or `drawn` says what it is in SI.
"""

from collections.abc import Iterator
from dataclasses import field, fields
from typing import Any

from lbgc.sensor.errors import ONE, Proportional


def figure(part: str, default: Any = 0.0) -> Any:
    """A field that is this part of `lbgc.sensor.imu.Triad`; several keys of one part say one thing
    in different units."""
    return field(default=default, metadata={"part": part})


def drawn(
    name: str, cause: str, lifetime: str, follows: str, size: str = "own", warms: bool = False
) -> Any:
    """A field that is the size (`own`, `cross`) of what is drawn once under this name: see
    `lbgc.sensor.errors.Proportional`."""
    kind = Proportional(name, cause, lifetime, follows, warms=warms)
    return field(default=0.0, metadata={"drawn": kind, "size": size})


def bias(lifetime: str) -> Any:
    """A field that is the size of the bias that is drawn for this lifetime."""
    return drawn(f"bias_{lifetime}", f"bias of the {lifetime}", lifetime, ONE)


def keys_of(config: Any) -> dict[str, list[str]]:
    """The keys of each part, in the order of the table."""
    found: dict[str, list[str]] = {}
    for row in fields(config):
        if "part" in row.metadata:
            found.setdefault(row.metadata["part"], []).append(row.name)
    return found


def drawn_of(config: Any) -> Iterator[tuple[str, str, Proportional]]:
    """Key, size and kind of all that is drawn once."""
    for row in fields(config):
        if "drawn" in row.metadata:
            yield row.name, row.metadata["size"], row.metadata["drawn"]
