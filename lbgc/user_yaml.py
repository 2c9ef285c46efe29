"""Checks of a user's own YAML files (`--config-dir`) before Hydra reads any of them.

Hydra can run code that a file names (`_target_`, callbacks, logging classes), and a small YAML file
can grow without end (aliases of aliases). A sensor's figures need neither, so both are refused.
"""

import argparse
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml
from omegaconf import OmegaConf

_MOST_BYTES, _MOST_NODES, _MOST_DEPTH, _MOST_FILES = 1_000_000, 10_000, 20, 1000
_MOST_DIGITS = 400
_PACKAGE = re.compile(r"^\s*#\s*@package\s+(\S+)", re.MULTILINE)
_OF_HYDRA = ("launcher", "sweeper", "sweep", "mode")
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def brought(arguments: Sequence[str]) -> list[Path]:
    """The directories of configurations that a command line names."""
    parser = argparse.ArgumentParser(add_help=False, exit_on_error=False)
    for name, short in (("--config-dir", "-cd"), ("--config-path", "-cp")):
        parser.add_argument(name, short)
    try:
        named, _ = parser.parse_known_args(list(arguments))
    except argparse.ArgumentError:
        return []  # Hydra reports the error
    return [Path(value) for value in vars(named).values() if value]


def check_directory(directory: Path) -> None:
    """Check all YAML files in a directory. Raises ValueError, with the file and the reason, where
    Hydra may not read one."""
    seen = 0
    for place, inside, names in os.walk(directory):
        for name in inside:
            if Path(place, name).is_symlink():  # os.walk does not follow it, but Hydra would
                raise ValueError(f"{Path(place, name)} is a link to a directory")
        for name in sorted(names):
            if not name.endswith(".yaml"):
                continue
            file, seen = Path(place, name), seen + 1
            if seen > _MOST_FILES:
                raise ValueError(f"{directory} holds more than {_MOST_FILES} YAML files")
            if file.relative_to(directory).parts[0] == "hydra":
                raise ValueError(f"{file}: Hydra's own settings cannot be brought along")
            if not file.is_file():
                raise ValueError(f"{file} is no file")
            with file.open("rb") as opened:
                check(opened.read(_MOST_BYTES + 1), str(file))


def check(content: bytes, name: str) -> None:
    """Check one file's content. Raises ValueError, with the reason, where it is refused."""
    if len(content) > _MOST_BYTES:
        raise ValueError(f"{name} is longer than {_MOST_BYTES} bytes")
    try:
        text = content.decode()
        _Check().run(text)
        OmegaConf.create(text)  # as Hydra will
    except Exception as error:
        raise ValueError(f"{name}: {' '.join(str(error).split())}") from error
    for package in _PACKAGE.findall(text):
        if package.split(".")[0] == "hydra":
            raise ValueError(f"{name}: Hydra's own settings cannot be brought along")


@dataclass
class _Open:
    """A list or a mapping whose end has not been read yet."""

    anchor: str | None
    is_mapping: bool
    size: int = 1
    """Number of values so far, with every alias written out"""
    key: str | None = None
    """The key that was read last"""
    key_due: bool = True
    """Whether a key comes next, and not a value"""


class _Check:
    """A check of YAML's events that refuses too many values, with every alias written out, too deep
    nesting, and keys that have a meaning to Hydra."""

    def __init__(self) -> None:
        self.open = [_Open(None, False)]
        self.sizes: dict[str, int] = {}

    def run(self, text: str) -> None:
        """Check a YAML text. Raises ValueError where it is refused."""
        for event in yaml.parse(text, _LOADER):
            self._take(event)
            if sum(part.size for part in self.open) > _MOST_NODES:
                raise ValueError(f"holds more than {_MOST_NODES} values")
            if len(self.open) > _MOST_DEPTH:
                raise ValueError(f"is nested more than {_MOST_DEPTH} deep")

    def _take(self, event: yaml.Event) -> None:
        """Check one event."""
        if getattr(event, "tag", None) not in (None, "!"):
            raise ValueError(f"the tag {event.tag}")
        if isinstance(event, yaml.CollectionStartEvent):
            self._key_or_value(None)
            self.open.append(_Open(event.anchor, isinstance(event, yaml.MappingStartEvent)))
        elif isinstance(event, yaml.CollectionEndEvent):
            ended = self.open.pop()
            self._add(ended.size, ended.anchor)
        elif isinstance(event, yaml.ScalarEvent):
            _check_scalar(event.value)
            self._key_or_value(event.value)
            self._add(1, event.anchor)
        elif isinstance(event, yaml.AliasEvent):
            self._key_or_value(None)
            self._add(self.sizes.get(event.anchor, 1), None)
            if len(self.open) == 2 and self.open[1].key == "hydra":
                raise ValueError("hydra as an alias")

    def _add(self, size: int, anchor: str | None) -> None:
        """Count a value of this size into the innermost collection, and keep the size by its
        anchor."""
        self.open[-1].size += size
        if anchor:
            self.sizes[anchor] = size

    def _key_or_value(self, text: str | None) -> None:
        """Take a node as the key or as the value that comes next in the innermost mapping, and
        check keys. text : a scalar's; None for other nodes."""
        inside = self.open[-1]
        if not inside.is_mapping:
            return
        inside.key_due = not inside.key_due
        if inside.key_due:
            return
        if text is None or text == "<<" or (text[:1] == "_" and text[-1:] == "_"):
            raise ValueError(f"{text or 'a list or an alias'} as a parameter's name")
        if len(self.open) == 3 and self.open[1].key == "hydra" and text not in _OF_HYDRA:
            raise ValueError(f"hydra.{text} cannot be brought along; {', '.join(_OF_HYDRA)} can")
        inside.key = text


def _check_scalar(value: str) -> None:
    """Raise ValueError at a scalar with several interpolations, or at a number of many digits."""
    if value.count("${") > 1 or ("${" in value and len(value) > _MOST_DIGITS):
        raise ValueError("a value with more than one ${...}")
    if len(value) > _MOST_DIGITS and value.lstrip("+-").replace("_", "").isdigit():
        raise ValueError(f"a number of more than {_MOST_DIGITS} digits")
