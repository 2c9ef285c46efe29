"""A row of the one table of datasheet keys: which part of a sensor's model a key is.

The table is `GyroConfig` and `AccelConfig` themselves: a field's name ends in its unit, its default
and its docstring stand beside it, and one of these functions says what it is in SI.
"""

from collections.abc import Iterator
from dataclasses import field, fields
from typing import Any

from lbgc.sensor.errors import ONE, Proportional


def term(kind: type, parameter: str, default: Any = 0.0, positive: bool = False) -> Any:
    """A field that is this parameter of what evolves within a recording, or of the output filter;
    several keys of one parameter say one thing in different units. The kind's first parameter is
    its size: where that is zero, an axis has no such term. positive : whether zero is refused."""
    about = {"term": kind, "parameter": parameter, "positive": positive}
    return field(default=default, metadata=about)


def minimum(kind: type, parameter: str) -> Any:
    """A field that says such a parameter by the Allan deviation's lowest point."""
    about = {"term": kind, "parameter": parameter, "minimum": True}
    return field(default=None, metadata=about)


def several() -> Any:
    """A field that is a list of terms, each with a table of its own."""
    return field(default=(), metadata={"several": True})


def counts(kind: type) -> Any:
    """A field that is the count of an output that is counted in this way."""
    return field(default=None, metadata={"counts": kind, "positive": True})


def limit() -> Any:
    """A field that is the range of the output."""
    return field(default=None, metadata={"limit": True, "positive": True})


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


def terms_of(config: Any) -> Iterator[tuple[type, dict[str, list[str]]] | str]:
    """Each kind of term, where its first row stands, with the keys of each of its parameters; and
    the names of fields that are lists of terms, in between."""
    kinds: dict[type, dict[str, list[str]]] = {}
    for row in fields(config):
        if "term" in row.metadata:
            keys = kinds.setdefault(row.metadata["term"], {})
            keys.setdefault(row.metadata["parameter"], []).append(row.name)
    for row in fields(config):
        if row.metadata.get("several"):
            yield row.name
        if (kind := row.metadata.get("term")) in kinds:
            yield kind, kinds.pop(kind)


def named(kind: str, config: Any) -> dict[str, Any]:
    """The keys of rows that say this of themselves (`counts`, `limit`, `minimum`, `positive`), and
    what they say."""
    return {row.name: row.metadata[kind] for row in fields(config) if row.metadata.get(kind)}


def drawn_of(config: Any) -> Iterator[tuple[str, str, Proportional]]:
    """Key, size and kind of all that is drawn once."""
    for row in fields(config):
        if "drawn" in row.metadata:
            yield row.name, row.metadata["size"], row.metadata["drawn"]


def alternatives(config: Any) -> Iterator[set[str]]:
    """Groups of keys that say one thing in different units or words."""
    for own in terms_of(config):
        if not isinstance(own, str):
            yield from (set(keys) for keys in own[1].values() if len(keys) > 1)
