"""Look at a log that nobody prepared: what it is, what its sensor is worth, and how to read it.

python lbgc/look.py FILE log.latitude=48.1
"""

import re
import sys
from dataclasses import asdict, dataclass, field
from itertools import chain, count
from pathlib import Path
from typing import Any

from tqdm import tqdm

from lbgc.commands import run_main
from lbgc.data.looking import pair
from lbgc.data.looking.doctor import looked
from lbgc.data.readers.formats.files import is_bag_directory
from lbgc.data.readers.raw import find, is_of_headings
from lbgc.errors import InputError, require
from lbgc.outputs import fingerprint, listed, mark_latest, shown, task_directory, write_atomically
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
    gyro_columns: str | list[Any] | None = None
    accel_columns: str | list[Any] | None = None
    gyro_rows: list[Any] | None = None
    accel_rows: list[Any] | None = None
    accel_path: str | None = None
    accel_table: str | None = None
    accel_time_column: Any = None
    accel_late_s: float | None = None
    time_column: Any = None
    time_unit: str | None = None
    rate_hz: float | None = None
    gaps: str | None = None
    repeats: str | None = None
    gyro_unit: str | None = None
    accel_unit: str | None = None
    gyro_scale: float | list[float] | None = None
    accel_scale: float | list[float] | None = None
    gyro_offset: float | list[float] | None = None
    accel_offset: float | list[float] | None = None
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
    leave_out: list[list[float]] | None = None
    rows: list[Any] | None = None
    plate_axis: str | None = None
    most_bias_deg_per_h: float | None = None

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
        good = self.name is None or self.name.isidentifier()
        require(good, "name", self.name, "must be a plain word")


def main(config: LookConfig) -> Path:
    """Examine every file; print, draw and write what was found; return the directory of the
    pictures."""
    directory = task_directory("look", fingerprint(asdict(config)))
    files: list[str | tuple[str, str]] = [o for file in config.files for o in _files_of(file)]
    apart = pair.of_files([str(own) for own in files], config.log.keys())
    if apart is not None:
        both = " and ".join(shown(Path(own).name) for own in apart)
        print(f"{both} are taken as gyros and accelerometers of one sensor: look at one file at a")
        print("time where they are not\n")
        files = [apart, *(own for own in files if own not in apart)]
    require(config.name is None or len(files) == 1, "name", config.name, "is for one file")
    two = config.log.accel_path
    require(two is None or len(files) == 1, "log.accel_path", two, "is for one file of gyros")
    refused: dict[str, InputError] = {}
    names: set[str] = set()
    for file in tqdm(files, "looking", leave=False, disable=len(files) < 2):
        try:
            names.add(_one(file, config, directory, names))
        except InputError as error:
            if len(files) == 1:
                raise
            refused[" and ".join(_each(file))] = error
        print()
    if len(refused) == len(files):
        raise next(iter(refused.values()))
    if refused:
        print(f"{len(refused)} of {len(files)} are no logs that can be read:")
        for file, why in refused.items():
            print(f"  {shown(file)}: {why}")
    mark_latest(directory)
    return directory


def _files_of(file: str) -> list[str]:
    """The logs that a path names: itself, or the files of a directory which is no log by itself, as
    a bag's is, or one of recordings at stated headings."""
    path = find(file)
    if not path.is_dir() or is_bag_directory(path) or is_of_headings(path):
        return [file]
    found = [own for own in listed(path, "*") if own.is_file() or is_bag_directory(own)]
    require(bool(found), "files", file, "is a directory without files")
    return [str(own) for own in found]


def _each(file: str | tuple[str, str]) -> tuple[str, ...]:
    """The files of one log: one, or that of gyros and that of accelerometers."""
    return (file,) if isinstance(file, str) else file


def _one(file: str | tuple[str, str], config: LookConfig, directory: Path, taken: set[str]) -> str:
    """Examine one log; returns the name of its description, which is none of those taken."""
    first, *other = _each(file)
    said = config.log.keys() | ({"accel_path": str(find(other[0]))} if other else {})
    look = looked(find(first), said)
    name = config.name or _word(look.name)
    name = next(own for own in chain([name], (f"{name}_{k}" for k in count(2))) if own not in taken)
    found = None if look.rest is None else look_text.deviations(look.rest)
    print(look_text.report(look, found))
    if found is not None:
        picture = directory / f"{name}.png"
        write_atomically(picture, png(draw(look, found)))
        print(f"picture: {picture}")
    if look.asks:
        print(look_text.asked(look, _each(file)))
    if not look.is_described:
        return name
    description = Path(config.out) / "log" / f"{name}.yaml"
    if description.exists() and not description.read_text(errors="replace").startswith(_OURS):
        raise InputError("name", name, "", f"{description} is there and is not of this command: "
                         "give name=ANOTHER")  # fmt: skip
    description.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(description, look_text.description(look, _OURS))
    print(f"description: {description}")
    print(look_text.commands(look, config.out, name))
    return name


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
