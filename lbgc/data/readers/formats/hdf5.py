"""HDF5 files, MATLAB's of version 7.3 among them: each group of datasets with equally many rows is
a table. Nothing outside the file is read, and no filter is loaded that a file names."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lbgc.data.readers.formats.extras import needed
from lbgc.data.readers.formats.table import AT_ONCE, Pieces, Table, is_column, named_columns
from lbgc.data.readers.formats.variables import Variable, extent, sideways, tables_of

MAGIC = b"\x89HDF\r\n\x1a\n"
PLACES = (0, *(512 << at for at in range(12)))
"""Where the format's mark may stand, bytes from the start; what is before it is the user's."""
_DEEPEST, _MOST = 12, 10_000


def read(path: Path) -> list[Table]:
    """The tables of an HDF5 file. Raises ValueError where it refers to other files, or holds no
    table; InputError where h5py is missing."""
    h5py = needed("h5py")
    file = h5py.File(path, "r")
    variables = []
    for count, (name, dataset) in enumerate(_datasets(h5py, file, "", _DEEPEST)):
        if count >= _MOST:
            raise ValueError(f"holds more than {_MOST} datasets")
        own = _variable(name, dataset)
        variables += [] if own is None else [own]
    return tables_of(variables, path.stem)


def _datasets(h5py: Any, group: Any, above: str, deeper: int) -> Iterator[tuple[str, Any]]:
    """The datasets of a group and of the groups in it, with their names. Links within the file are
    passed over: what they lead to has a name of its own."""
    for key in group:
        link = group.get(key, getlink=True)
        if isinstance(link, h5py.ExternalLink):
            raise ValueError(f"{above}{key} is a link to another file")
        if not isinstance(link, h5py.HardLink) or key.startswith("#"):
            continue
        own = group[key]
        if isinstance(own, h5py.Group):
            if deeper == 0:
                raise ValueError(f"is nested more than {_DEEPEST} deep")
            yield from _datasets(h5py, own, f"{above}{key}/", deeper - 1)
        elif isinstance(own, h5py.Dataset):
            yield f"{above}{key}", own


def _variable(name: str, dataset: Any) -> Variable | None:
    """The variable of a dataset; None where it is no table of numbers."""
    if dataset.shape is None or dataset.dtype.hasobject:
        return None
    fields, size = named_columns(dataset.dtype), extent(dataset.shape)
    fields = {own: width for own, width in fields.items() if width == 1}
    if size is None or (fields and len(dataset.shape) != 1):
        return None
    if not (fields or is_column(dataset.dtype)):
        return None
    if dataset.external or dataset.is_virtual:
        raise ValueError(f"{name} has its values in another file")
    rows, width = size
    names = tuple(fields)

    def pieces(which: Sequence[int]) -> Pieces:
        turned = sideways(dataset.shape)
        for first in range(0, rows, step):
            part = slice(first, first + step)
            if fields:
                values = dataset[part]
                yield [values[names[at]] for at in which]
            elif len(dataset.shape) == 1:
                yield [dataset[part]] * len(which)
            else:
                values = dataset[:, part].T if turned else dataset[part]
                yield [np.ascontiguousarray(values[:, at]) for at in which]

    chunk = (dataset.chunks or (1,))[-1 if sideways(dataset.shape) else 0]
    step = max(chunk, AT_ONCE // chunk * chunk)
    return Variable(name, rows, names or ("",) * width, pieces, _unit(dataset), bool(fields))


def _unit(dataset: Any) -> str:
    """The unit that a dataset's attributes state; empty where they state none."""
    for key in ("units", "unit"):
        if key in dataset.attrs:
            value = dataset.attrs[key]
            value = value.item() if isinstance(value, np.ndarray) and value.size == 1 else value
            text = value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
            return text[:100]
    return ""
