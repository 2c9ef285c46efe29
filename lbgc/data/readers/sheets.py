"""Text and Parquet files of numbers as sheets of named columns, whatever the layout of their rows.

Nothing in a file is evaluated. Rows that do not fit are refused, with the number of their line.
"""

import codecs
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from lbgc import machine, outputs
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

_HELD = 4.0
"""Bytes of memory for each byte of a text file while it is read."""
_HEAD = 4 * 2**20
"""Bytes at a file's start in which its layout is looked for."""
_HEAD_ROWS, _HEAD_ROW = 100_000, 120
"""Rows of a sheet's head, and bytes of such a row of text."""
_SHOWN = 60
"""Characters of a file's text that a message shows, at most."""
_MARKS = (codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (
    codecs.BOM_UTF16_BE, "utf-16")  # fmt: skip
_SINGLE_QUOTES = re.compile(rb"^'", re.M)


def shown(text: object) -> str:
    """Text from a file in a form for messages, which name several."""
    return outputs.shown(text, _SHOWN)


class Source(Protocol):
    """What columns are read from."""

    def columns(self, which: Sequence[int]) -> tuple[list[np.ndarray], list[str]]:
        """Columns by position, as `Sheet.columns` gives them."""

    def head(self, rows: int) -> "Source":
        """A source of the first rows alone."""


@dataclass(frozen=True)
class Sheet:
    """The columns of a file, whose values are read when they are asked for."""

    file: str
    """The file's name in messages"""
    names: tuple[str, ...]
    """The columns' names; an empty text where the file has no header, or a column no name"""
    units: tuple[str, ...]
    """The units in a row beneath the header; empty where there is none"""
    rate_hz: float | None
    """Sample rate that comments and preamble state, Hz"""
    source: Source
    """The file's content"""
    notes: tuple[str, ...] = ()
    """What was found or assumed before any column was read, plain sentences"""

    @property
    def width(self) -> int:
        """The number of columns."""
        return len(self.names)

    @property
    def has_header(self) -> bool:
        """Whether any column has a name."""
        return any(self.names)

    def head(self) -> "Sheet":
        """The sheet with its first rows alone, some 100,000."""
        return replace(self, source=self.source.head(_HEAD_ROWS))

    def columns(self, which: Sequence[int]) -> tuple[list[np.ndarray], list[str]]:
        """Read columns by position, each (T,): float64, int64 where they are whole numbers of more
        than nine digits (stamps), or datetime64; text where they are none of these. With notes of
        what was left out."""
        values, notes = self.source.columns(which)
        return values, [*self.notes, *notes]


def sheet(path: Path, key: str = "log.path") -> Sheet:
    """Read the sheet of a Parquet or text file. Raises InputError, naming the file by `key`, where
    that cannot be done."""
    if path.suffix.lower() in (".parquet", ".pq"):
        table = tables.read_parquet(path, key)
        return Sheet(path.stem, table.names, (), None, table)
    return text_sheet(_content(path, key), path, key)


def _content(path: Path, key: str) -> bytes:
    """A text file's content, if it is not too large."""
    with reading(key, path):
        require_size(path, key)
        return path.read_bytes()


def text_sheet(content: bytes, path: Path, key: str) -> Sheet:
    """The sheet in a text file's content. Raises InputError, naming the file by `key`, where it is
    no table."""
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


def require_size(path: Path, key: str) -> None:
    """Raise InputError where a text file is larger than is read, or than this machine has memory
    for."""
    size, most = path.stat().st_size, tables.LARGEST
    require(size <= most, key, path, f"has {size} bytes, and {most} are the most")
    machine.require_memory(key, path, _HELD * size, f"a text of {size} bytes")


def _utf8(content: bytes, key: str, path: Path) -> bytes:
    """A file's content as UTF-8 text with line feeds at line ends, whatever its encoding. Raises
    InputError where it is no text."""
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
    require(
        b"\0" not in content,
        key,
        path,
        "is no text, and in no format that is known: it "
        "has null characters. Rows of numbers and nothing else are read by log.dtype",
    )
    if b"\r" in content:
        content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return content


@dataclass(frozen=True)
class _Text:
    """A text file's content, and how its columns are parsed."""

    content: bytes
    """The file as UTF-8, with line feeds at line ends"""
    layout: Dialect
    """The layout of its rows"""
    file: str
    """The file's name in messages"""

    def head(self, rows: int) -> "_Text":
        """Its first lines alone."""
        most = rows * _HEAD_ROW
        if len(self.content) <= most:
            return self
        return replace(self, content=self.content[: self.content.rindex(b"\n", 0, most) + 1])

    def columns(self, which: Sequence[int]) -> tuple[list[np.ndarray], list[str]]:
        """The columns as `Sheet.columns` gives them: by the fast parser, without a last line that
        was cut short if need be, or else line by line."""
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
        """Notes of the lines before the rows that were left out."""
        return [
            f"first lines: number {at + 1} of {self.file} ({shown(line)}) is no row of "
            f"{self.layout.width} and was left out"
            for at, line in self.layout.skipped
        ]

    def _kind(self, at: int) -> str:
        """The kind of a column by the first row: number, stamp or text."""
        field = self.layout.numbers[at] if at < len(self.layout.numbers) else ""
        if field.lstrip("+-").isdigit() and len(field) > 9:
            return "stamp"
        is_value = is_number(field, self.layout.decimal) or not field or field[0].lower() in "ni-+"
        return "number" if is_value else "text"

    def _body(self) -> bytes:
        """The rows alone, without comments, and with fields separated by one character."""
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
        """The columns by the fast parser; None where some row or number does not fit."""
        own = self.layout
        return tables.parsed(body, own.separator, own.decimal, own.width, kinds)

    def _lines(self) -> list[tuple[int, str]]:
        """The lines of rows, each with its number counted from one."""
        lines = self.content.decode("utf-8", "replace").split("\n")[self.layout.first :]
        return [(at + self.layout.first + 1, line) for at, line in enumerate(lines)
                if line.strip() and not is_comment(line, self.layout.separator)]  # fmt: skip

    def _mended(self, body: bytes) -> tuple[bytes, list[str]]:
        """The body without a last line that was cut short, and a note of that. Raises InputError at
        any other row whose number of fields differs from the first row's."""
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
        """The columns parsed line by line, for numbers that the fast parser does not accept, such
        as +1.5. Raises InputError at a field that is not a number."""
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
"""Words that stand for a missing number."""
