"""Text files of numbers as sheets, whatever the layout of their rows.

A text is read block by block, as often as it is asked for columns. Nothing in a file is evaluated.
Rows that do not fit are refused, with the number of their line.
"""

import codecs
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any

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
from lbgc.data.readers.sheets import Piece, Sheet, shown
from lbgc.data.readers.stated import stated_rate
from lbgc.errors import InputError, reading, require

_HEAD = 4 * 2**20
"""Bytes at a file's start in which its layout is looked for."""
_HEAD_ROW = 120
"""Bytes of a row of a sheet's head."""
_BLOCK = 16 * 2**20
"""Bytes of a file that are read at once."""
_MARKS = (codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (
    codecs.BOM_UTF16_BE, "utf-16")  # fmt: skip

Open = Callable[[], AbstractContextManager[IO[bytes]]]
"""Opens a text's bytes, from the first on"""


def sheet(path: Path, key: str = "log.path") -> Sheet:
    """Read the sheet of a Parquet or text file. Raises InputError, naming the file by `key`, where
    that cannot be done."""
    if path.suffix.lower() in (".parquet", ".pq"):
        table = tables.read_parquet(path, key)
        return Sheet(path.stem, table.names, (), None, table)
    return text_sheet(lambda: path.open("rb"), path, key)


def text_sheet(opened: Open, path: Path, key: str) -> Sheet:
    """The sheet in a text. Raises InputError, naming the file by `key`, where it is no table."""
    with reading(key, path):
        require_size(path, key)
    content = _Content(opened, path, key)
    start, lines, comma, count = b"", 1, False, 0
    for block in content.blocks():
        start, count = start or block, count + 1
        lines += block.count(b"\n")
        comma = comma or b"," in block
    require(bool(start.strip()), key, path, "is empty")
    head = start[:_HEAD].decode("utf-8", "replace").split("\n")[: MOST_BEFORE + 1000]
    whole = len(start) <= _HEAD
    if not whole:
        head = head[:-1]
    found = layout(head, key, path.name, whole, comma)
    names = tuple(name.strip() for name in found.names or ("",) * found.width)
    rate = stated_rate(head[: found.first])
    source = _Text(content, found, path.name, lines - found.first, count > 1)
    return Sheet(path.stem, names, found.units, rate, source)


def require_size(path: Path, key: str) -> None:
    """Raise InputError where a text file is larger than is read."""
    size = path.stat().st_size
    require(size <= tables.LARGEST, key, path, f"has {size} bytes, and {tables.LARGEST} are "
            "the most")  # fmt: skip


@dataclass(frozen=True)
class _Content:
    """A file's text."""

    opened: Open
    path: Path
    key: str
    """The key that names it in messages"""

    def blocks(self) -> Iterator[bytes]:
        """The text in blocks of whole lines, as UTF-8 with line feeds at line ends, whatever its
        encoding. Raises InputError where it is no text."""
        rest, size = b"", 0
        with reading(self.key, self.path, "is no text"), self.opened() as stream:
            part = stream.read(_BLOCK)
            encoding = _encoding(part)
            decoder = None if encoding is None else codecs.getincrementaldecoder(encoding)()
            while part:
                size += len(part)
                about = f"unfolds to more than {tables.LARGEST} bytes, which are the most"
                require(size <= tables.LARGEST, self.key, self.path, about)
                rest += part if decoder is None else decoder.decode(part).encode()
                part = b""  # before the next one is read
                cut = _line_end(rest)
                if cut:
                    yield self._plain(rest[:cut], encoding)
                    rest = rest[cut:]
                part = stream.read(_BLOCK)
            if decoder is not None:
                decoder.decode(b"", True)
            if rest:
                yield self._plain(rest, encoding)

    def _plain(self, block: bytes, encoding: str | None) -> bytes:
        """A block as UTF-8 with line feeds at line ends."""
        if encoding is None and not block.isascii():
            try:
                block.decode()
            except UnicodeDecodeError:
                block = block.decode("latin-1").encode()
        null = b"\0" in block
        about = "is no text, and in no format that is known: it has null characters. "
        about += "Rows of numbers and nothing else are read by log.dtype"
        require(not null, self.key, self.path, about)
        if b"\r" in block:
            block = block.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        return block


def _encoding(start: bytes) -> str | None:
    """The encoding that a text's first bytes show; None for UTF-8, or Latin-1 where that fails."""
    encoding = next((name for mark, name in _MARKS if start.startswith(mark)), None)
    if encoding is None and start[:4000].count(b"\0") > len(start[:4000]) // 4:
        odd = start[1:4000:2].count(b"\0") > start[:4000:2].count(b"\0")
        encoding = "utf-16-le" if odd else "utf-16-be"
    return encoding


def _line_end(text: bytes) -> int:
    """The place behind the last whole line of a text that goes on; 0 where there is none."""
    cut = text.rfind(b"\n") + 1
    return cut if cut else text.rfind(b"\r", 0, len(text) - 1) + 1


@dataclass(frozen=True)
class _Text:
    """A text file's content, and how its columns are parsed."""

    content: _Content
    """The file's text"""
    layout: Dialect
    """The layout of its rows"""
    file: str
    """The file's name in messages"""
    rows: int
    """Its lines from the first row on"""
    is_long: bool
    """Whether it is of several blocks"""
    most: int | None = None
    """Bytes of its head alone; None for all"""

    def head(self, rows: int) -> "_Text":
        """Its first lines alone."""
        most = rows * _HEAD_ROW
        return replace(self, most=most, rows=min(self.rows, most // self.layout.width + 1))

    def _blocks(self) -> Iterator[tuple[bytes, int, bool]]:
        """The text in blocks, each with the number of lines before it, and whether it is the
        last."""
        before, this = 0, b""
        for block in self.content.blocks():
            if self.most is not None:
                last = len(block) <= self.most
                yield block if last else block[: block.rindex(b"\n", 0, self.most) + 1], 0, last
                return
            if this:
                yield this, before, False
                before += this.count(b"\n")
            this = block
        if this:
            yield this, before, True

    def pieces(self, which: Sequence[int]) -> Iterator[Piece]:
        """The columns as `Sheet.columns` gives them, block by block: by the fast parser, without a
        last line that was cut short if need be, or else line by line."""
        kinds = {at: self._kind(at) for at in which}
        if self.is_long:
            kinds |= {at: "text" if self._is_dated(at) else "string"
                      for at, kind in kinds.items() if kind == "text"}  # fmt: skip
        notes = self._skipped()
        for block, before, is_last in self._blocks():
            body = self._body(block, before)
            if not body.strip():
                continue
            read = self._read(body, kinds)
            if read is None and "stamp" in kinds.values():
                kinds = {at: "number" if kind == "stamp" else kind for at, kind in kinds.items()}
                read = self._read(body, kinds)
            if read is None:
                lines = self._lines(block, before)
                body, note = self._mended(body, lines, is_last)
                notes += note
                read = self._read(body, kinds) if body.strip() else [np.empty(0)] * len(kinds)
                if read is None:
                    read = self._one_by_one(lines, kinds)
            places = dict(zip(kinds, read, strict=True))
            yield [places[at] for at in which], notes
            notes = []
        if notes:
            yield [np.empty(0)] * len(which), notes

    def _is_dated(self, at: int) -> bool:
        """Whether a column of text is of dates from the first row to the last."""
        bodies = (self._body(block, before) for block, before, _ in self._blocks())
        read = (self._read(body, {at: "text"}) for body in bodies if body.strip())
        kinds = {"" if own is None else own[0].dtype.kind for own in read}
        return kinds in ({"m"}, {"M"})

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

    def _body(self, block: bytes, before: int) -> bytes:
        """The rows of a block alone, without comments, and with fields separated by one character.
        before : the lines before it."""
        at = 0
        for _ in range(self.layout.first if before == 0 else 0):
            at = block.index(b"\n", at) + 1
        body = block[at:]
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

    def _lines(self, block: bytes, before: int) -> list[tuple[int, str]]:
        """The lines of rows in a block, each with its number counted from one."""
        lines = block.decode("utf-8", "replace").split("\n")
        first = self.layout.first if before == 0 else 0
        return [(before + at + 1, line) for at, line in enumerate(lines) if at >= first
                and line.strip() and not is_comment(line, self.layout.separator)]  # fmt: skip

    def _mended(
        self, body: bytes, rows: list[tuple[int, str]], is_last: bool
    ) -> tuple[bytes, list[str]]:
        """A block's body without a last line that was cut short, if it is the last block, and a
        note of that. Raises InputError at any other row whose number of fields differs from the
        first row's."""
        for at, (number, line) in enumerate(rows):
            found = len(fields(line, self.layout.separator))
            if found == self.layout.width:
                continue
            if is_last and at == len(rows) - 1 and found < self.layout.width:
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

    def _one_by_one(self, lines: list[tuple[int, str]], kinds: dict[int, str]) -> list[np.ndarray]:
        """The columns parsed line by line, for numbers that the fast parser does not accept, such
        as +1.5. Raises InputError at a field that is not a number."""
        values: list[list[Any]] = [[] for _ in kinds]
        decimal = self.layout.decimal
        for number, line in lines:
            found = fields(line, self.layout.separator)
            if len(found) != self.layout.width:
                continue  # the last line, cut short
            for (at, kind), own in zip(kinds.items(), values, strict=True):
                field = found[at]
                if kind in ("text", "string"):
                    own.append(field)
                    continue
                if not is_number(field, decimal) and field.lower() not in _EMPTY:
                    raise InputError(
                        f"{self.file}: line {number}", shown(field), "", "is no number"
                    )
                own.append(float(field.replace(",", ".") or "nan") if field.lower() not in _EMPTY
                           else np.nan)  # fmt: skip
        return [
            np.array(own, dtype=object if kind in ("text", "string") else float)
            for kind, own in zip(kinds.values(), values, strict=True)
        ]


_EMPTY = {"", "nan", "na", "n/a", "null", "-nan", "#n/a"}
"""Words that stand for a missing number."""
