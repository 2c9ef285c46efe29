"""A log that is described by its file alone: `log.path=FILE`, where the doctor is sure."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from lbgc.data.logconfig import LogConfig
from lbgc.data.looking.doctor import looked
from lbgc.data.readers.raw import find
from lbgc.errors import InputError, require
from lbgc.outputs import shown

AUTO = "auto"
"""The reader of a log whose description is found."""


@dataclass(frozen=True)
class AnyLog(LogConfig):
    """A log's description; with the reader `auto`, what it does not say is found in the file."""

    for_heading: ClassVar[bool] = True
    """Whether a heading is asked for, so that doubts which concern nothing else are asked about."""

    @classmethod
    def adopted(cls, mapping: Mapping[str, Any]) -> Mapping[str, Any]:
        """The keys of a description, found where the reader is `auto`, and then printed; those of
        several files by the first. Raises InputError, naming the key, where the file does not tell
        them."""
        if mapping.get("reader") != AUTO:
            return mapping
        said = {key: value for key, value in mapping.items() if value is not None}
        given = said.pop("path", "")
        apart: dict[str, Any] = {
            key: said.pop(key) for key in ("angles_deg", "gap_s") if key in said
        }
        path = str(given[0] if isinstance(given, list) and given else given)
        require(bool(path), "path", path, "must name a file")
        other = said.get("accel_path")
        if isinstance(other, list):
            apart["accel_path"] = other
            said["accel_path"] = other[0] if other else None
        del said["reader"]
        look = looked(find(path), said, cls.for_heading)
        asked = [own for own in look.asks if cls.for_heading or not own.heading_only]
        if asked:
            about = f"is not told by the file: {asked[0].doubt} {asked[0].why}"
            given = " ".join(shown(own) for own in (path, said.get("accel_path")) if own)
            raise InputError(asked[0].key, None, "", f"{about} (python lbgc/look.py {given})")
        error = look.refusal
        if cls.for_heading and error is not None:
            raise InputError(
                error.name.removeprefix("log."), error.value, error.unit, error.choices
            )
        for guess in look.guesses:
            if guess.value is not None:
                about = f"; {guess.doubt}" if guess.doubt else ""
                print(f"found log.{guess.key}={guess.written}: {guess.why}{about}")
        keys = {**look.keys, **apart}
        return {**keys, "path": given} if isinstance(given, list) else keys


@dataclass(frozen=True)
class NoiseLog(AnyLog):
    """A log's description, found likewise, of which no heading is asked for."""

    for_heading: ClassVar[bool] = False
