"""docs/keys.md: every key of an IMU, a scene and a protocol, from the dataclasses that hold them.

make keys        write it anew
"""

import ast
import inspect
import json
from collections.abc import Iterator
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, get_args, get_type_hints

from helpers import ROOT

from lbgc.commands import COMPLETE, as_written
from lbgc.units import unit_of
from sim.generate import GenerateConfig

PAGE = ROOT / "docs/keys.md"
_HEAD = """# Every key of an IMU, a scene and a protocol

What can I say of a sensor (`imu`), of the bench (`scene`) and of what the plate does (`protocol`),
in which unit, and what holds where I say nothing?

A key is set on the command line, `imu.gyro.arw_deg_per_sqrt_h=0.1`, or in a file: the presets in
`conf/imu/`, `conf/scene/` and `conf/protocol/`, or your own `MY/imu/NAME.yaml`, which
`--config-dir MY imu=NAME` finds. A file only says what it knows; the rest are the defaults below.
What a command's configuration comes to, presets included, is at the end of its `--help`. A key's
name ends in its unit.

- **number or [x, y, z]**: one figure, or one for each axis: forward, right, down.
- **number or [low, high]**: one figure, or two between which each recording draws its own,
  uniformly.
- **list of groups**: lines that wander, say
  `lines: [{deg_per_h: [20, 20, 0], hz: 7, width_hz: 0.5}]`.
- An IMU file of Kalibr's is taken as it is: its `gyroscope_noise_density`, `gyroscope_random_walk`,
  `accelerometer_noise_density` and `accelerometer_random_walk` are SI and two-sided, so N and K
  themselves.
- N, B, K, Q and R are IEEE Std 952's; [glossary.md](glossary.md) says what each is.

This page is written by `make keys` from the dataclasses that hold the keys.
"""
_TAKES = {
    "float": "number",
    "str": "text",
    "None": "null",
    "Axes": "number or [x, y, z]",
    "Spread": "number or [low, high]",
    "tuple[float, ...]": "list of numbers",
    "tuple[tuple[float, ...], ...]": "list of lists of numbers",
    "tuple[GyroLine, ...]": "list of groups",
    "tuple[AccelLine, ...]": "list of groups",
}


def page() -> str:
    hints = get_type_hints(GenerateConfig)
    sections = (part for name in COMPLETE for part in _sections(name, hints[name], "##"))
    return "\n".join([_HEAD, *sections])


def _sections(path: str, config: type, heading: str) -> Iterator[str]:
    """A group's own keys, then those of the groups in it."""
    said, hints, rows, inside = _said(config), get_type_hints(config), [], []
    for field in fields(config):
        kind = hints[field.name]
        each = next(filter(is_dataclass, get_args(kind)), None)
        if is_dataclass(kind) or each is not None:
            inside.append((field.name, each or kind))
        if not is_dataclass(kind):
            takes, meaning = said[field.name]
            assert field.default_factory is MISSING  # a tuple needs none
            default = "must be given" if field.default is MISSING else _shown(field.default)
            rows.append((f"`{field.name}`", unit_of(field.name), takes, default, meaning))
    yield f"{heading} `{path}`\n\n{' '.join((config.__doc__ or '').split())}\n"
    if rows:
        head = ("key", "unit", "takes", "default", "what it is")
        yield "".join(f"| {' | '.join(row)} |\n" for row in (head, ("---",) * len(head), *rows))
    for name, own in inside:
        yield from _sections(f"{path}.{name}", own, "###")


def _shown(default: Any) -> str:
    return f"`{json.dumps(as_written(default))}`"


def _said(config: type) -> dict[str, tuple[str, str]]:
    """Of each field what it takes and its docstring, which only the source has."""
    (own,) = ast.parse(inspect.getsource(config)).body
    assert isinstance(own, ast.ClassDef)
    found = {}
    for field, after in zip(own.body, own.body[1:], strict=False):
        if isinstance(field, ast.AnnAssign) and isinstance(after, ast.Expr):
            kinds = ast.unparse(field.annotation).split(" | ")
            takes = " or ".join(_TAKES.get(kind, kind) for kind in kinds)
            meaning = " ".join(ast.literal_eval(after.value).split())
            found[ast.unparse(field.target)] = (takes, meaning)
    return found


if __name__ == "__main__":
    PAGE.write_text(page())
