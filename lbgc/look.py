"""Look at a log that nobody prepared: what it is, what its sensor is worth, and how to read it.

python lbgc/look.py FILE log.latitude=48.1
"""

import re
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from tqdm import tqdm

from lbgc.commands import run_main
from lbgc.data.looking.doctor import looked
from lbgc.data.readers.raw import find
from lbgc.errors import InputError, require
from lbgc.outputs import fingerprint, mark_latest, shown, task_directory, write_atomically
from lbgc.report import look_text
from lbgc.report.figures import png
from lbgc.report.look_page import draw

_OURS = "# Written by lbgc/look.py"
"""How a description begins that may be written over."""


@dataclass(frozen=True)
class Said:
    """What the user says of a log, by the keys of `LogConfig`; null: it is found, or asked for."""

    latitude: float | None = None
    heading_deg: float | None = None
    table: str | None = None
    dtype: list[str] | None = None
    skip_bytes: int | None = None
    columns: list[Any] | None = None
    time_column: Any = None
    time_unit: str | None = None
    rate_hz: float | None = None
    gaps: str | None = None
    repeats: str | None = None
    gyro_unit: str | None = None
    accel_unit: str | None = None
    gyro_scale: float | None = None
    accel_scale: float | None = None
    axes: list[str] | None = None
    accel_axes: list[str] | None = None
    temperature_column: Any = None
    heading_column: Any = None
    plate_column: Any = None
    plate_unit: str | None = None
    plate_scale: float | None = None
    positions: list[list[float]] | None = None
    from_s: float | None = None
    to_s: float | None = None

    def keys(self) -> dict[str, Any]:
        """Those that are said."""
        return {key: value for key, value in asdict(self).items() if value is not None}


@dataclass(frozen=True)
class LookConfig:
    """The keys of `conf/look.yaml`."""

    files: list[str] = field(default_factory=list)
    """Log files, or directories of recordings."""
    out: str = "mine"
    """Directory of the descriptions, for `--config-dir`."""
    name: str | None = None
    """The description's name; null: the file's."""
    log: Said = field(default_factory=Said)
    """What is known of the files."""

    def __post_init__(self) -> None:
        require(bool(self.files), "files", self.files, "give a log: python lbgc/look.py FILE")
        require(self.name is None or len(self.files) == 1, "name", self.name, "is for one file")
        good = self.name is None or self.name.isidentifier()
        require(good, "name", self.name, "must be a plain word")


def main(config: LookConfig) -> Path:
    """Examine every file; print, draw and write what was found; return the directory of the
    pictures."""
    directory = task_directory("look", fingerprint(asdict(config)))
    refused: InputError | None = None
    for file in tqdm(config.files, "looking", leave=False, disable=len(config.files) < 2):
        try:
            _one(file, config, directory)
        except InputError as error:
            if len(config.files) == 1:
                raise
            refused = refused or error
            print(f"{shown(file)}: {error}\n")
    if refused is not None and not any(directory.iterdir()):
        raise refused
    mark_latest(directory)
    return directory


def _one(file: str, config: LookConfig, directory: Path) -> None:
    """Examine one file."""
    look = looked(find(file), config.log.keys())
    name = config.name or _word(look.name)
    found = None if look.record is None else look_text.deviations(look.record)
    print(look_text.report(look, found))
    if found is not None:
        picture = directory / f"{name}.png"
        write_atomically(picture, png(draw(look, found)))
        print(f"picture: {picture}")
    if look.asks:
        print(look_text.asked(look, file))
    if not look.is_described:
        return
    description = Path(config.out) / "log" / f"{name}.yaml"
    if description.exists() and not description.read_text(errors="replace").startswith(_OURS):
        raise InputError("name", name, "", f"{description} is there and is not of this command: "
                         "give name=ANOTHER")  # fmt: skip
    description.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(description, look_text.description(look, _OURS))
    print(f"description: {description}")
    print(look_text.commands(look, config.out, name))


def _word(name: str) -> str:
    """A file's name as the name of a description: letters, digits and underscores."""
    word = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_").lower() or "log"
    return word if word[0].isalpha() else f"log_{word}"


def as_override(arguments: list[str]) -> list[str]:
    """The arguments with those that are paths, and no `key=value` or option, written as
    `files=['PATH',...]`."""
    paths = [own for own in arguments if not own.startswith("-")
             and ("=" not in own or Path(own).exists())]  # fmt: skip
    if not paths:
        return arguments
    quoted = ",".join("'" + p.replace("\\", "\\\\").replace("'", "\\'") + "'" for p in paths)
    return [f"files=[{quoted}]", *(own for own in arguments if own not in paths)]


if __name__ == "__main__":
    sys.argv[1:] = as_override(sys.argv[1:])
    run_main(main, LookConfig, "look")
