"""Reading of a user's own YAML files, those of `--config-dir DIR`: DIR/imu/mine.yaml for imu=mine.

Such a file is data, and lies in DIR: a link that leads elsewhere is refused. It is parsed without
tags, merge keys and interpolations, within bounds, and has keys of its group's dataclass only;
nothing that it says configures Hydra or names code.
"""

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, ClassVar, get_args, get_type_hints

import yaml

from lbgc.errors import InputError, require, require_choice
from lbgc.outputs import listed

GROUPS = ("imu", "scene", "protocol", "model", "log", "experiment")
"""Groups of which files can be brought along. A cluster cannot: its scheduler is trusted with
code."""
_PLACES = ("out", "data", "run", "runs", "cluster")
"""Keys that an experiment cannot set, because they say what is written, opened or connected to."""
_MOST_BYTES, _MOST_VALUES, _MOST_DEPTH, _MOST_FILES = 100_000, 10_000, 20, 1000
_MOST_CHARACTERS = 1000
"""Of one value: a number's digits, too, are converted in a time that goes as their square."""
_MOST_ALIASES = 100
_MOST_BASES = 20
_NAME = re.compile(r"\w[\w.+-]*")
_DEFAULTS = re.compile(r"/?(imu|scene|protocol)_defaults(@[\w.]+)?")


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """YAML's safe loader, in which a key stands once, 1e-5 is a number, a date is a text, and `<<`
    is a key as any other."""

    yaml_implicit_resolvers: ClassVar = {
        first: [own for own in every if own[0].rpartition(":")[2] not in ("timestamp", "merge")]
        for first, every in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """A mapping, its keys checked."""
        keys = [key.value for key, _ in node.value]
        if not all(isinstance(key, yaml.ScalarNode) for key, _ in node.value):
            raise ValueError("a list or a group as a parameter's name")
        if twice := [key for key, count in Counter(keys).items() if count > 1]:
            raise ValueError(f"{', '.join(sorted(twice))} stands there twice")
        return super().construct_mapping(node, deep)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?[0-9][0-9_]*[eE][-+]?[0-9]+$"), [*"-+0123456789"]
)


def read(directory: Path, group: str, config_class: type) -> dict[str, Any]:
    """The files DIR/GROUP/*.yaml by name: each one's values, with its list of defaults under
    `defaults`; or the InputError that says why it is refused.

    config_class : dataclass whose keys the files have.
    """
    files = listed(directory / group, "*.yaml")
    most = f"holds more than {_MOST_FILES} files"
    require(len(files) <= _MOST_FILES, "--config-dir", directory / group, most)
    found: dict[str, Any] = {}
    for file in files:
        try:
            found[file.stem] = _checked(file, group, config_class)
        except Exception as error:  # a file may be anything
            why = " ".join(str(error).split())[:300] or type(error).__name__
            found[file.stem] = InputError(group, file, "", f"is refused ({why})")
    for name, values in found.items():
        if isinstance(values, dict) and not _ends(name, found):
            own = directory / group / f"{name}.yaml"
            found[name] = InputError(group, own, "", "is refused (the files that it is based on "
                                     "are too many, or itself)")  # fmt: skip
    return found


def _checked(file: Path, group: str, config_class: type) -> dict[str, Any]:
    """A file's values. Raises ValueError, with the reason, where it is refused."""
    if not file.is_file():
        raise ValueError("no file")
    if not file.resolve().is_relative_to(file.parent.parent.resolve()):
        raise ValueError("a link that leads out of the directory")
    if not _NAME.fullmatch(file.stem):
        raise ValueError(f"a name is made of letters, digits and ._+-, not {file.stem}")
    with file.open("rb") as opened:
        content = opened.read(_MOST_BYTES + 1)
    values = parse(content)
    entries = values.pop("defaults", [])
    if group == "experiment":
        for key in set(values) & set(_PLACES):
            raise ValueError(f"{key} is given on the command line, and in no file")
    _require_known(values, config_class)
    if entries:
        values["defaults"] = _defaults(entries, group)
    return values


def parse(content: bytes) -> dict[str, Any]:
    """The mapping of plain values that a YAML file holds. Raises ValueError where it holds anything
    else, or more than its bounds."""
    if len(content) > _MOST_BYTES:
        raise ValueError(f"longer than {_MOST_BYTES} bytes")
    text = content.decode()
    depth = aliases = 0
    for event in yaml.parse(text, _Loader):
        if getattr(event, "tag", None) is not None:
            raise ValueError(f"the tag {event.tag}")
        if len(getattr(event, "value", "")) > _MOST_CHARACTERS:
            raise ValueError(f"a value of more than {_MOST_CHARACTERS} characters")
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        aliases += isinstance(event, yaml.AliasEvent)
        if depth > _MOST_DEPTH or aliases > _MOST_ALIASES:
            raise ValueError(f"nested more than {_MOST_DEPTH} deep, or {_MOST_ALIASES} aliases")
    values = yaml.load(text, _Loader)
    values = {} if values is None else values
    if not isinstance(values, dict):
        raise ValueError("no group of parameters")
    _require_plain(values)
    return values


def _require_plain(values: Any) -> None:
    """Raise ValueError unless the values are groups and lists of texts, numbers, booleans and null,
    not too many of them with every alias written out, and no text is an interpolation."""
    waiting, seen = [values], 0
    while waiting:
        value = waiting.pop()
        seen += 1
        if seen > _MOST_VALUES:
            raise ValueError(f"more than {_MOST_VALUES} values")
        if isinstance(value, dict):
            waiting += [*value, *value.values()]
        elif isinstance(value, list):
            waiting += value
        elif isinstance(value, str) and "${" in value:
            raise ValueError(f"{value}: in a file, ${{...}} is not filled in; write what it stands "
                             "for")  # fmt: skip
        elif not isinstance(value, str | int | float | None):
            raise ValueError(f"a value of the kind {type(value).__name__}")


def _require_known(values: Mapping[Any, Any], config_class: type, above: str = "") -> None:
    """Raise InputError unless every key is one of the dataclass's, and there are groups of
    parameters only where it has dataclasses."""
    values = getattr(config_class, "adopted", lambda own: own)(values)
    hints = get_type_hints(config_class)
    for key, value in values.items():
        require_choice(f"key of {above or 'it'}", str(key), list(hints))
        group, waiting = group_of(hints[key]), [value]
        for own in waiting:
            waiting += own if isinstance(own, list) else []
            if isinstance(own, dict):
                require(group is not None, key, own, "must not be a group of parameters")
                _require_known(own, group, key)  # type: ignore[arg-type]


def group_of(annotation: Any) -> type | None:
    """The dataclass of a field that is one, may be one, or holds several."""
    every = (annotation, *get_args(annotation))
    return next((own for own in every if isinstance(own, type) and is_dataclass(own)), None)


def _defaults(entries: Any, group: str) -> list[Any]:
    """A file's list of defaults: of its own group at most one other file, and `_self_`; of an
    experiment also `override /GROUP: NAME`. Raises ValueError at anything else."""
    if not isinstance(entries, list) or len(entries) > 10:
        raise ValueError("defaults must be a list of at most 10")
    among = f"in its list of defaults, which takes _self_ and one other file of {group}, by name"
    kept: list[Any] = []
    for entry in entries:
        if isinstance(entry, str) and (completed := _DEFAULTS.fullmatch(entry)):
            kept.append(f"/{completed[1]}_defaults@_global_.{completed[1]}")
        elif isinstance(entry, str) and _NAME.fullmatch(entry):
            kept.append(entry)
        elif group == "experiment" and isinstance(entry, dict) and len(entry) == 1:
            ((where, name),) = entry.items()
            own = re.fullmatch(r"override /?(\w+)", str(where))
            if not own or own[1] not in GROUPS[:-1] or not _NAME.fullmatch(str(name)):
                raise ValueError(f"{where}: {name} {among}")
            kept.append({f"override /{own[1]}": str(name)})
        else:
            raise ValueError(f"{str(entry)[:100]} {among}")
    if len(_bases(kept)) > 1:
        raise ValueError(f"{_bases(kept)} {among}")
    return kept


def _bases(defaults: list[Any]) -> list[str]:
    """The files of its own group that a list of defaults names."""
    names = (entry for entry in defaults if isinstance(entry, str) and entry != "_self_")
    return [name for name in names if _NAME.fullmatch(name)]


def _ends(name: str, found: Mapping[str, Any]) -> bool:
    """Whether the files that a file is based on, one after the other, come to an end."""
    for _ in range(_MOST_BASES):
        values = found.get(name)
        if not isinstance(values, dict):
            return True
        name = "".join(_bases(values.get("defaults", [])))
    return False
