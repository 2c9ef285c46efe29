"""Text files of numbers, however their rows are laid out: a sheet of named columns.

Nothing in a file is evaluated. Rows that do not fit are refused by their line's number.
"""

import codecs
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lbgc.data.readers import tables
from lbgc.data.readers.dialects import (
    MARKS,
    MOST_BEFORE,
    Dialect,
    fields,
    is_comment,
    is_number,
    layout,
)
from lbgc.data.readers.stated import stated_rate
from lbgc.errors import InputError, reading, require

_LARGEST = 4 * 2**30
"""Size of the largest file that is read, bytes."""
_HEAD = 4 * 2**20
_SHOWN = 60
_MARKS = (codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (
    codecs.BOM_UTF16_BE, "utf-16")  # fmt: skip
_SINGLE_QUOTES = re.compile(rb"^'", re.M)


def shown(text: object) -> str:
    """A file's own words as they may stand in a message: short, and harmless to a terminal."""
    plain = "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in str(text)[: 2 * _SHOWN])
    return plain if len(plain) <= _SHOWN else plain[: _SHOWN - 3] + "..."


@dataclass(frozen=True)
class Sheet:
    """A file's columns, read when asked for."""

    file: str
    names: tuple[str, ...]
    """Empty where the file has no header, or a column no name."""
    units: tuple[str, ...]
    """The units of a row beneath the header; empty where there is none."""
    rate_hz: float | None
    """Rate that comments and preamble state."""
    source: "tables.Table | _Text"

    @property
    def width(self) -> int:
        return len(self.names)

    @property
    def has_header(self) -> bool:
        return any(self.names)

    def columns(self, which: Sequence[int]) -> tuple[list[np.ndarray], list[str]]:
        """Columns by position, each (T,): float64, int64 where all are whole numbers of more than
        nine digits (stamps), or datetime64; or text where they are neither. And notes."""
        if isinstance(self.source, _Text):
            return self.source.columns(which)
        return [tables.column(self.source, at) for at in which], []


def sheet(path: Path, key: str = "log.path") -> Sheet:
    """A Parquet or text file's sheet. Raises InputError, naming the file by `key`."""
    if path.suffix.lower() in (".parquet", ".pq"):
        table = tables.read_parquet(path, key)
        return Sheet(path.stem, tuple(map(str, table.column_names)), (), None, table)
    with reading(key, path):
        size = path.stat().st_size
        require(size <= _LARGEST, key, path, f"has {size} bytes, and {_LARGEST} are the most")
        content = path.read_bytes()
    text = _utf8(content, key, path)
    del content
    head = text[:_HEAD].decode("utf-8", "replace").split("\n")[: MOST_BEFORE + 1000]
    whole = len(text) <= _HEAD
    if not whole:
        head = head[:-1]
    found = layout(head, key, path.name, whole, b"," in text)
    names = tuple(name.strip() for name in found.names or ("",) * found.width)
    rate = stated_rate(head[: found.first])
    return Sheet(path.stem, names, found.units, rate, _Text(text, found, path.name))


def _utf8(content: bytes, key: str, path: Path) -> bytes:
    """The text as UTF-8 with plain line ends, whatever it was in."""
    encoding = next((name for mark, name in _MARKS if content.startswith(mark)), None)
    if encoding is None and content[:4000].count(b"\0") > len(content[:4000]) // 4:
        odd = content[1:4000:2].count(b"\0") > content[:4000:2].count(b"\0")
        encoding = "utf-16-le" if odd else "utf-16-be"
    with reading(key, path, "is no text"):
        if encoding is not None:
            content = content.decode(encoding).encode()
        else:
            try:
                content.decode()
            except UnicodeDecodeError:
                content = content.decode("latin-1").encode()
    require(bool(content.strip()), key, path, "is empty")
    require(b"\0" not in content, key, path, "is no text: it has null characters")
    if b"\r" in content:
        content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return content


@dataclass(frozen=True)
class _Text:
    content: bytes
    """The file as UTF-8, with plain line ends."""
    layout: Dialect
    file: str

    def columns(self, which: Sequence[int]) -> tuple[list[np.ndarray], list[str]]:
        body, notes = self._body(), self._skipped()
        kinds = {at: self._kind(at) for at in which}
        read = self._read(body, kinds)
        if read is None and "stamp" in kinds.values():
            kinds = {at: "number" if kind == "stamp" else kind for at, kind in kinds.items()}
            read = self._read(body, kinds)
        if read is None:
            body, note = self._mended(body)
            notes += note
            read = self._read(body, kinds)
        if read is None:
            read = self._one_by_one(kinds)
        return read, notes

    def _skipped(self) -> list[str]:
        return [
            f"first lines: number {at + 1} of {self.file} ({shown(line)}) is no row of "
            f"{self.layout.width} and was left out"
            for at, line in self.layout.skipped
        ]

    def _kind(self, at: int) -> str:
        field = self.layout.numbers[at] if at < len(self.layout.numbers) else ""
        if field.lstrip("+-").isdigit() and len(field) > 9:
            return "stamp"
        is_value = is_number(field, self.layout.decimal) or not field or field[0].lower() in "ni-+"
        return "number" if is_value else "text"

    def _body(self) -> bytes:
        """The rows alone, separated by one character each."""
        at = 0
        for _ in range(self.layout.first):
            at = self.content.index(b"\n", at) + 1
        body = self.content[at:]
        for mark in map(str.encode, MARKS):
            if mark != self.layout.separator.encode() and mark in body:
                body = re.sub(rb"(?m)^[ \t]*" + re.escape(mark) + rb"[^\n]*(\n|\Z)", b"", body)
        if self.layout.separator == " ":
            body = re.sub(rb"(?m)^[ \t]+|[ \t]+$", b"", body)
            if b"\t" in body or b"  " in body:
                body = re.sub(rb"[ \t]+", b" ", body)
        return body

    def _read(self, body: bytes, kinds: dict[int, str]) -> list[np.ndarray] | None:
        """None where some row or number does not fit."""
        own = self.layout
        return tables.parsed(body, own.separator, own.decimal, own.width, kinds)

    def _lines(self) -> list[tuple[int, str]]:
        """Rows and their lines' numbers, counted from one."""
        lines = self.content.decode("utf-8", "replace").split("\n")[self.layout.first :]
        return [(at + self.layout.first + 1, line) for at, line in enumerate(lines)
                if line.strip() and not is_comment(line, self.layout.separator)]  # fmt: skip

    def _mended(self, body: bytes) -> tuple[bytes, list[str]]:
        """The body less a last line that was cut short. Raises InputError at any other row that has
        not as many fields as the first."""
        rows = self._lines()
        for at, (number, line) in enumerate(rows):
            found = len(fields(line, self.layout.separator))
            if found == self.layout.width:
                continue
            if at == len(rows) - 1 and found < self.layout.width:
                cut = body.rstrip(b"\n")
                note = (
                    f"last line: number {number} of {self.file} ({shown(line)}) has {found} fields "
                    f"of {self.layout.width} and was left out"
                )
                return cut[: cut.rfind(b"\n") + 1], [note]
            raise InputError(
                f"{self.file}: line {number}",
                shown(line),
                "",
                f"has {found} fields, where the rows before it have {self.layout.width}",
            )
        return body, []

    def _one_by_one(self, kinds: dict[int, str]) -> list[np.ndarray]:
        """Numbers that the fast parser does not know, such as +1.5; and who is no number."""
        values: list[list[Any]] = [[] for _ in kinds]
        decimal = self.layout.decimal
        for number, line in self._lines():
            found = fields(line, self.layout.separator)
            if len(found) != self.layout.width:
                continue  # the last line, cut short
            for (at, kind), own in zip(kinds.items(), values, strict=True):
                field = found[at]
                if kind == "text":
                    own.append(field)
                    continue
                if not is_number(field, decimal) and field.lower() not in _EMPTY:
                    raise InputError(
                        f"{self.file}: line {number}", shown(field), "", "is no number"
                    )
                own.append(float(field.replace(",", ".") or "nan") if field.lower() not in _EMPTY
                           else np.nan)  # fmt: skip
        return [np.array(own) for own in values]


_EMPTY = {"", "nan", "na", "n/a", "null", "-nan", "#n/a"}
