"""The names of a dataset's files, by its schema."""

from collections.abc import Container, Iterable

from lbgc.data.schema import SCHEMA, VARIABLES

ROOT = "zarr.json"
SHA256_BYTES = 32
_OLDER = 4
"""The last schema of many files: see `lbgc.data.schema.READ`."""
_ROWS_OF_OLDER = {
    "digest": "SHA-256 of a finished shard's decoded arrays",
    "stored": "SHA-256 of a finished shard's identity, digest and files",
}
_ROWS = {
    "shards": "SHA-256 of a finished shard's identity and files, and of the files' names and sizes",
}


def separator(schema: int) -> str:
    """What stands between the indices in a file's name. A slash makes directories, which take more
    time than files do, and the name of a shard's file has two or three."""
    return "/" if schema <= _OLDER else "."


def file_of(array: str, *indices: int, schema: int = SCHEMA) -> str:
    """The file of an array's values with these indices, of shards and not of values."""
    return f"{array}/" + separator(schema).join(["c", *map(str, indices)])


def shard_files(shard: int, variables: Iterable[str], schema: int = SCHEMA) -> list[str]:
    """The files that a shard may have: one a variable, by name. Since schema 5 there is none where
    all values are zero, which is what Zarr reads where there is no file."""
    others = {name: (0,) * (len(VARIABLES[name].dims) - 1) for name in variables}
    return [file_of(n, shard, *others[n], schema=schema) for n in sorted(others)]


def shard_of(file: str, variables: Container[str]) -> int | None:
    """The shard whose file this is, one of these variables'; None where it is no shard's."""
    array, _, indices = file.partition("/c.")
    first = indices.partition(".")[0]
    return int(first) if array in variables and first.isdecimal() else None


def row_arrays(schema: int = SCHEMA) -> dict[str, tuple[int, str]]:
    """The arrays of the manifest, in the order in which they are written: the bytes that each has
    of a shard, and what they are."""
    rows, size = (_ROWS_OF_OLDER, 1) if schema <= _OLDER else (_ROWS, 2)
    return {f"manifest/{name}": (SHA256_BYTES * size, what) for name, what in rows.items()}


def row_files(shard: int, schema: int = SCHEMA) -> list[str]:
    """The files of a shard's row in the manifest."""
    return [file_of(name, shard, 0, schema=schema) for name in row_arrays(schema)]


def names_of(variables: Iterable[str], schema: int = SCHEMA) -> tuple[str, ...]:
    """The files of a dataset of these variables and without recordings, but for the manifest's own,
    `manifest/zarr.json`. The root is first: it says whose all the others are."""
    return (
        ROOT,
        *(f"{name}/zarr.json" for name in (*row_arrays(schema), *variables, "time", "axis")),
        *(file_of(name, 0, schema=schema) for name in ("time", "axis")),
    )
