"""What a dataset's files must be: the manifest's checksums, and what does not agree with them.

`manifest/zarr.json` names every document (each file written when the dataset was started) with its
SHA-256, the dataset's identity, and a checksum of its own. `manifest/shards` has a row for each
finished shard: SHA-256 of its files as they are stored, and of their names and sizes alone. A
flipped bit anywhere, or a file lost, cut short or taken from another dataset, disagrees.
"""

import hashlib
import json
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple, TypeAlias

from lbgc.data.encoding import CHECKSUM_BYTES, with_checksum
from lbgc.data.files import ROOT, SHA256_BYTES, names_of, row_arrays, row_files
from lbgc.data.place import Entry, Place, is_partial
from lbgc.data.schema import ALWAYS, READ, SCHEMA, VARIABLES
from lbgc.errors import InputError, require
from lbgc.outputs import UNSEALED, as_json, fingerprint, is_sealed, seal

MANIFEST = "manifest/zarr.json"
AGAIN = "run the command that generated it again"
_NO_VARIABLES = {"manifest", "time", "axis"}
_ARRAY = r"(/zarr\.json|/c(/\d+)*|/c(\.\d+)+)?"
_OWN = re.compile(
    rf"zarr\.json|({'|'.join([*VARIABLES, 'time', 'axis'])}){_ARRAY}"
    rf"|manifest(/zarr\.json|/(digest|stored|shards){_ARRAY})?"
)
"""Names of a dataset's own files and directories."""
Read: TypeAlias = Callable[[str], bytes | None]
NONE = "is no dataset; make one with `python sim/generate.py`"


def sha256(content: bytes) -> str:
    """SHA-256 of a file's content, in hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def compose(identity: str, documents: Mapping[str, bytes]) -> bytes:
    """The manifest's own document: a Zarr group whose attributes are the checksums."""
    attributes = {
        "identity": identity,
        "documents": {name: sha256(documents[name]) for name in sorted(documents)},
        "checksum": UNSEALED,
    }
    group = {"attributes": attributes, "zarr_format": 3, "node_type": "group"}
    return seal(as_json(group).encode())


def _attributes(content: bytes | None) -> Mapping[str, Any] | None:
    """A Zarr document's attributes; None where it is not one."""
    try:
        attributes = json.loads(content or b"")["attributes"]
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    return attributes if isinstance(attributes, dict) else None


def _intact(place: Place) -> Mapping[str, Any] | None:
    """The manifest's attributes; None where it is missing or damaged."""
    content = place.read(MANIFEST)
    attributes = _attributes(content)
    if content is None or attributes is None:
        return None
    if not is_sealed(content, str(attributes.get("checksum"))):
        return None
    told = isinstance(attributes.get("documents"), dict) and "identity" in attributes
    return attributes if told else None


def _claim(place: Place) -> tuple[str, int] | None:
    """Identity and schema of the dataset by its root document, where the two agree with its
    configuration."""
    attributes = _attributes(place.read(ROOT)) or {}
    schema, configuration = attributes.get("schema"), attributes.get("configuration")
    if not isinstance(configuration, dict) or type(schema) is not int:
        return None
    try:
        identity = fingerprint({"schema": schema, **configuration})
    except RecursionError:
        return None
    return (identity, schema) if attributes.get("identity") == identity else None


def is_named(place: Place) -> bool:
    """Whether the root document has an identity and the configuration that it is of."""
    return _claim(place) is not None


def owner(place: Place) -> str | None:
    """Identity of the dataset here; None where nothing is here, or what interrupted runs leave.

    Where the root document is damaged the manifest says it. Raises InputError where there is
    something else, a dataset of another schema, or one that is beyond repair.
    """
    claim, manifest = _claim(place), _intact(place)
    if claim is not None:
        identity, schema = claim
        read = " and ".join(map(str, READ))
        what = f"has schema {schema}, this version reads {read}; generate it again"
        require(schema in READ, "data", place, what)
        return identity
    if manifest is not None:
        return str(manifest.get("identity"))
    if all(map(is_partial, place.names())):
        return None
    was_one = "identity" in (_attributes(place.read(ROOT)) or {}) or place.read(MANIFEST)
    what = f"is damaged beyond repair ({ROOT}, {MANIFEST}); delete it" if was_one else NONE
    raise InputError("data", place, "", what)


def damaged_documents(place: Place, names: Iterable[str]) -> list[str]:
    """Which of these documents are not what the manifest says; all, where it says nothing itself
    or was another dataset's."""
    manifest, claim = _intact(place), _claim(place)
    checksums = {} if manifest is None else manifest["documents"]
    others = (None, *((manifest["identity"], schema) for schema in READ)) if manifest else ()
    if manifest is None or claim not in others:
        return [MANIFEST, *names]
    return [n for n in names if checksums.get(n) != sha256(place.read(n) or b"")]


def contents(place: Place) -> tuple[tuple[str, ...], int]:
    """The variables that the dataset here names in its manifest, in the order of VARIABLES, and its
    schema; what a new one has, where that is damaged. Raises InputError where it names others."""
    manifest = _intact(place)
    if manifest is None:
        return ALWAYS, SCHEMA
    files = {str(name) for name in manifest["documents"]}
    rows = {schema: {f"{name}/{ROOT}" for name in row_arrays(schema)} for schema in READ}
    schema = next((number for number in READ if rows[number] <= files), SCHEMA)
    named = {n.removesuffix("/zarr.json") for n in files if n.count("/") == 1 and n.endswith(ROOT)}
    unknown = named - VARIABLES.keys() - _NO_VARIABLES
    what = f"has variables that this version does not know ({', '.join(sorted(unknown)[:4])})"
    require(not unknown, "data", place, f"{what}; read it with the version that made it")
    return tuple(name for name in VARIABLES if name in named), schema


def documents_of(place: Place) -> tuple[str, ...]:
    """The files that the dataset here has without recordings, but for the manifest's own."""
    return names_of(*contents(place))


def stored_checksum(
    identity: str, shard: int, files: Iterable[str], read: Read, digest: bytes = b""
) -> bytes:
    """SHA-256 over whose a shard is and its files, as `read` has them. digest : SHA-256 of its
    decoded arrays, up to schema 4."""
    checksum = hashlib.sha256(f"{identity} {shard} ".encode() + digest)
    for name in files:
        content = read(name)
        size = -1 if content is None else len(content)
        checksum.update(f"{name} {size} ".encode())
        checksum.update(content or b"")
    return checksum.digest()


def sizes_checksum(sizes: Mapping[str, int]) -> bytes:
    """SHA-256 over the names and sizes of the files that a shard has, by which a missing one is
    known from one that was never written."""
    return hashlib.sha256("".join(f"{n} {sizes[n]} " for n in sorted(sizes)).encode()).digest()


class Row(NamedTuple):
    """What the manifest says of a finished shard."""

    stored: bytes
    """`stored_checksum` of its files"""
    sizes: bytes = b""
    """`sizes_checksum` of them; empty up to schema 4"""
    digest: bytes = b""
    """SHA-256 of its decoded arrays, up to schema 4"""


def rows(place: Place, entries: Iterable[str], schema: int, shards: int) -> dict[int, Row]:
    """The rows of all shards that have a whole one. entries : names of the files here."""
    array = next(iter(row_arrays(schema)))
    pattern = re.compile(rf"{array}/c[./](\d+)[./]0")
    numbers = (int(own[1]) for own in map(pattern.fullmatch, entries) if own)
    named = {shard: row_files(shard, schema) for shard in numbers if shard < shards}
    sizes = [size for size, _ in row_arrays(schema).values()]
    found = place.read_all(name for names in named.values() for name in names)
    told = {}
    for shard, names in named.items():
        parts = [found.get(name) or b"" for name in names]
        if all(len(p) == n + CHECKSUM_BYTES for p, n in zip(parts, sizes, strict=True)) and all(
            part == with_checksum(part[:-CHECKSUM_BYTES]) for part in parts
        ):
            row = b"".join(part[:-CHECKSUM_BYTES] for part in parts)
            first, second = row[:SHA256_BYTES], row[SHA256_BYTES:]
            older = len(sizes) > 1
            told[shard] = Row(second, digest=first) if older else Row(first, sizes=second)
    return told


def strays(entries: Mapping[str, Entry]) -> list[str]:
    """Files that an interrupted run left half-written, and links, which lead elsewhere, in the
    places of a dataset's own files and directories. Whatever else somebody has put here stays."""
    return [
        name
        for name, entry in sorted(entries.items())
        if is_partial(name) or (entry.is_link and _OWN.fullmatch(name))
    ]
