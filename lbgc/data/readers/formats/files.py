"""The choice of the reader for a file: by its content first, by the ending of its name second."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from lbgc.data.logconfig import LogConfig
from lbgc.data.readers import tables
from lbgc.data.readers.formats import (
    apart,
    bags,
    compressed,
    dataflash,
    hdf5,
    matlab,
    numpy_arrays,
    r_data,
    raw_binary,
    ulog,
)
from lbgc.data.readers.formats.extras import require_installed
from lbgc.data.readers.formats.table import Collected, Table, chosen
from lbgc.data.readers.picked import picked
from lbgc.data.readers.sheets import Sheet
from lbgc.data.readers.texts import text_sheet
from lbgc.errors import InputError, reading, require

_PARQUET, _ARROW = b"PAR1", (b"ARROW1\0\0", b"\xff\xff\xff\xff")
_HEAD = 132
_KEY = "log.path"


@dataclass(frozen=True)
class Format:
    """How files of one format are read: by which module of this room, and with which package."""

    reader: str
    """The module that `child` calls, or one of text, parquet, compressed, npy and npz"""
    package: str | None = None
    """The module of the extra `logs` that it needs"""


_TEXT, _PARQUET_FILE, _COMPRESSED = Format("text"), Format("parquet"), Format("compressed")
_NPY, _NPZ, _MATLAB, _ARROW_FILE = (Format(own) for own in ("npy", "npz", "matlab", "feather"))
_HDF5, _BAG = Format("hdf5", "h5py"), Format("bags", "rosbags")
_ULOG, _DATAFLASH = Format("ulog", "pyulog"), Format("dataflash")
_R = Format("r_data", "rdata")
_IN_HERE = (_TEXT, _PARQUET_FILE, _COMPRESSED, _NPY, _NPZ)

_BY_MAGIC: dict[bytes, Format] = {
    b"\x93NUMPY": _NPY,
    bags.ROS1: _BAG,
    bags.MCAP: _BAG,
    bags.SQLITE: _BAG,
    ulog.MAGIC: _ULOG,
    dataflash.MAGIC: _DATAFLASH,
    dataflash.TEXT: _DATAFLASH,
    **dict.fromkeys(_ARROW, _ARROW_FILE),
    **dict.fromkeys(r_data.MAGICS, _R),
}
_BY_ENDING: dict[str, Format] = {
    **dict.fromkeys((".parquet", ".pq"), _PARQUET_FILE),
    **dict.fromkeys((".feather", ".arrow", ".ipc", ".arrows"), _ARROW_FILE),
    **dict.fromkeys((".h5", ".hdf5", ".hdf", ".nc"), _HDF5),
    **dict.fromkeys((".bag", ".db3", ".mcap"), _BAG),
    **dict.fromkeys((".rda", ".rdata", ".rds"), _R),
    **dict.fromkeys((".gz", ".bz2", ".xz", ".zip"), _COMPRESSED),
    ".npy": _NPY,
    ".npz": _NPZ,
    ".mat": _MATLAB,
    ".ulg": _ULOG,
}


def format_of(path: Path) -> Format:
    """The format of a file, or of a bag's directory. Raises InputError where that cannot be
    opened."""
    if path.is_dir():
        return _BAG
    with reading(_KEY, path), path.open("rb") as file:
        head = file.read(_HEAD)
        found = next((own for magic, own in _BY_MAGIC.items() if head.startswith(magic)), None)
        if found is not None:
            return found
        if head.startswith(compressed.ZIP):
            names = compressed.members(path)
            return _NPZ if names and all(own.endswith(".npy") for own in names) else _COMPRESSED
        if compressed.is_compressed(head):
            first = compressed.unfolded(path, most=r_data.LONGEST_MAGIC)
            return _R if first.startswith(r_data.MAGICS) else _COMPRESSED
        if head.startswith(matlab.MAGIC) and head[126:128] in (b"IM", b"MI"):
            return _HDF5 if head[124:126] in (b"\x00\x02", b"\x02\x00") else _MATLAB
        for place in hdf5.PLACES:
            file.seek(place)
            if file.read(len(hdf5.MAGIC)) == hdf5.MAGIC:
                return _HDF5
        file.seek(max(0, path.stat().st_size - len(_PARQUET)))
        if head.startswith(_PARQUET) and file.read() == _PARQUET:
            return _PARQUET_FILE
    return _BY_ENDING.get(path.suffix.lower(), _TEXT)


def is_bag_directory(path: Path) -> bool:
    """Whether a path is the directory of a ROS 2 bag."""
    return path.is_dir() and (path / bags.METADATA).is_file()


@contextmanager
def opened(
    path: Path, config: LogConfig, fits: Callable[[Sheet], object] | None = None
) -> Iterator[Sheet]:
    """The sheet of the table that a file's recording is in, read within the `with` block.

    fits : raises InputError where a sheet is not the one that is meant; None: where it has no
    columns of an IMU. Raises InputError where the file cannot be read, or the table must be named.
    """
    kind = Format("raw") if config.dtype is not None else format_of(path)
    if kind.package is not None:
        require_installed(kind.package)
    with ExitStack() as stack:
        if kind in (_TEXT, _PARQUET_FILE, _COMPRESSED):
            about = f"names a table, and {path.name} is one: leave log.table out"
            require(config.table is None, "log.table", config.table, about)
            if kind == _COMPRESSED:
                yield text_sheet(lambda: compressed.stream(path), path, _KEY)
            else:
                yield (
                    text_sheet(lambda: path.open("rb"), path, _KEY)
                    if kind == _TEXT
                    else _parquet(path)
                )
            return
        if kind in _IN_HERE or config.dtype is not None:
            with reading(_KEY, path):
                found = _read_here(kind, path, config)
        else:
            found = stack.enter_context(apart.read_apart(kind.reader, path, _size(path)))
        yield _sheet_of(found, path, config, fits)


def _parquet(path: Path) -> Sheet:
    """The sheet of a Parquet file, whatever its name ends in."""
    table = tables.read_parquet(path, _KEY)
    return Sheet(path.stem, table.names, (), None, table)


def _read_here(kind: Format, path: Path, config: LogConfig) -> list[Table]:
    """The tables of a file whose reader needs no process of its own."""
    if config.dtype is not None:
        return raw_binary.read(path, config.dtype, config.skip_bytes)
    return numpy_arrays.read_npy(path) if kind == _NPY else numpy_arrays.read_npz(path)


def _size(path: Path) -> int:
    """The bytes of a file, or of the files in a directory."""
    with reading(_KEY, path):
        return sum(own.stat().st_size for own in (path.iterdir() if path.is_dir() else [path]))


def _sheet_of(
    found: Sequence[Table],
    path: Path,
    config: LogConfig,
    fits: Callable[[Sheet], object] | None,
) -> Sheet:
    """The sheet of the table that fits, as `opened` says, or that the configuration names."""

    def able(own: Table) -> bool:
        made = _as_sheet(own, path)
        try:
            if fits is not None:
                fits(made)
            else:
                picked(made, replace(config, time_column=None, rate_hz=1.0))
        except InputError:
            return False
        return True

    table, notes = chosen(found, config.table, able, path.name)
    made = _as_sheet(table, path)
    return replace(made, notes=(*table.notes, *notes))


def _as_sheet(own: Table, path: Path) -> Sheet:
    """A table as a sheet."""
    names = tuple(name.strip() for name in own.names)
    return Sheet(f"{path.stem}, table {own.name}" if own.name != path.stem else path.stem,
                 names, own.units, None, Collected(own, str(path)))  # fmt: skip
