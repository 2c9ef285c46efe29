"""The layout of a text file of numbers: separator, decimal sign, header, row of units, preamble."""

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from lbgc.data.readers.column_names import unit
from lbgc.errors import InputError

MARKS = ("#", "%", "//", ";", "!")
"""Characters with which comments begin."""
MOST_BEFORE = 20_000
"""Lines that may stand before the data, at most."""
_FOLLOWING = 10
"""Lines after the first row that are compared with it."""
_ABOVE = 6
"""Lines above the data, without empty ones, among which the header is looked for."""
_LONGEST_LINE, _LONGEST_HEADER = 100_000, 10_000
"""Characters of a row and of a header, at most."""
_BLANKS = " "
"""The separator that stands for any number of blanks and tabs."""
_NUMBER = {
    ".": re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?"),
    ",": re.compile(r"[+-]?(\d+,?\d*|,\d+)([eE][+-]?\d+)?"),
}
_WITH_UNIT = re.compile(r'"[^"]*"|[^\s(\[]+(?:\s*[(\[][^)\]]*[)\]])?')
"""A column's name with its unit in brackets."""
_NO_NUMBER = {"nan", "inf", "-inf", "+inf", "na", "n/a", "null", "-nan"}
"""Words that may stand in the place of a number."""


@dataclass(frozen=True)
class Dialect:
    """The layout of a file's rows, and its header."""

    separator: str
    """The character between fields; a blank stands for any number of blanks and tabs"""
    decimal: str
    """The decimal sign, a point or a comma"""
    first: int
    """The line of the first row, counted from zero"""
    width: int
    """Number of fields in a row"""
    names: tuple[str, ...] | None
    """The columns' names; None where there is no header"""
    units: tuple[str, ...]
    """The units in a row beneath the header; empty where there is none"""
    numbers: tuple[str, ...]
    """The first row's fields"""
    skipped: tuple[tuple[int, str], ...]
    """Lines between header and rows that hold numbers but are not laid out as rows, each with its
    number counted from zero"""


def layout(lines: Sequence[str], key: str, name: str, whole: bool, comma: bool) -> Dialect:
    """Find the layout of a file that begins with these lines.

    key, name : what messages call the file; whole : whether these are all its lines; comma :
    whether the file has commas anywhere, which decides the decimal sign where the first rows have
    whole numbers only. Raises InputError where no line begins rows of numbers.
    """
    for least in (6, 4, 2, 1):
        for first in range(min(len(lines), MOST_BEFORE)):
            found = _best(lines, first, least)
            if found is not None:
                separator, decimal = found
                if decimal == "." and separator != "," and comma and not _has(lines, first, "."):
                    decimal = ","
                return _with_header(lines, first, separator, decimal)
    where = "" if whole or len(lines) < MOST_BEFORE else f" in its first {MOST_BEFORE} lines"
    raise InputError(
        key,
        name,
        "",
        f"has no rows of numbers{where}, by comma, semicolon, tab or blank",
    )


def fields(line: str, separator: str) -> list[str]:
    """The fields of a line, without blanks and quotes around them."""
    if separator == _BLANKS:
        found = re.findall(r'"[^"]*"|\S+', line)
        return [field.strip('"') for field in found]
    try:
        found = next(csv.reader([line], delimiter=separator), [])
    except csv.Error:
        found = line.split(separator)
    return [field.strip() for field in found]


def is_number(field: str, decimal: str) -> bool:
    """Whether a field is a number with this decimal sign."""
    return _NUMBER[decimal].fullmatch(field) is not None


def is_comment(line: str, separator: str) -> bool:
    """Whether a line begins with a comment mark, other than the separator."""
    start = line.lstrip()
    return any(start.startswith(mark) for mark in MARKS if mark != separator)


@lru_cache(maxsize=2048)
def _pattern(line: str, separator: str, decimal: str) -> tuple[bool | None, ...]:
    """Whether each field of a line is a number; None for an empty field, which may be either."""
    if len(line) > _LONGEST_LINE:
        return ()
    return tuple(
        None if not field else is_number(field, decimal) or field.lower() in _NO_NUMBER
        for field in fields(line, separator)
    )


def _alike(one: Sequence[bool | None], other: Sequence[bool | None]) -> bool:
    """Whether two lines have as many fields, and numbers in the same ones."""
    pairs = zip(one, other, strict=False)
    return len(one) == len(other) and all(a is None or b is None or a == b for a, b in pairs)


def _has(lines: Sequence[str], first: int, character: str) -> bool:
    """Whether a character occurs in the thousand lines from `first` on."""
    return any(character in line for line in lines[first : first + 1000])


def _best(lines: Sequence[str], first: int, least: int) -> tuple[str, str] | None:
    """The separator and the decimal sign with which rows begin at this line: at least `least` of
    its fields are numbers, and at least half of the next lines have numbers in the same fields.
    None where that is so with none."""
    line = lines[first]
    if not any(character.isdigit() for character in line[:2000]):
        return None
    best, most = None, 0
    for separator in ("\t", ";", ",", "|", _BLANKS):
        if separator not in line and separator != _BLANKS:
            continue
        for decimal in (".", ","):
            own = _pattern(line, separator, decimal)
            if is_comment(line, separator) or own.count(True) < least:
                continue
            after = _following(lines, first, separator)
            others = [_pattern(text, separator, decimal) for text in after]
            total = sum(row.count(True) for row in [own, *others])
            fits = sum(_alike(own, row) for row in others)
            if 2 * fits >= len(after) and total > most:
                best, most = (separator, decimal), total
    return best


def _following(lines: Sequence[str], first: int, separator: str) -> list[str]:
    """The next lines that are neither empty nor comments, ten at most."""
    some = lines[first + 1 : first + 1 + 3 * _FOLLOWING]
    rows = [text for text in some if text.strip() and not is_comment(text, separator)]
    return rows[:_FOLLOWING]


def _with_header(lines: Sequence[str], first: int, separator: str, decimal: str) -> Dialect:
    """The layout with the header and the row of units that stand above the first row."""
    row = tuple(fields(lines[first], separator))
    width = len(row)
    units: tuple[str, ...] = ()
    names = None
    skipped: list[tuple[int, str]] = []
    above = [at for at in range(first - 1, -1, -1) if lines[at].strip()][:_ABOVE]
    for at in above:
        found = _header(lines[at], separator, width, not row[-1])
        if found is None:
            if _pattern(lines[at], separator, decimal).count(True) > 1:
                skipped.append((at, lines[at]))
            continue
        if not units and all(not word or unit(word) or word in "-()[]" for word in found):
            units = found
            continue
        names = found
        break
    if names is None and units:  # names that could be units, such as s and g
        names, units = units, ()
    between = tuple(skipped[::-1]) if names is not None else ()
    return Dialect(separator, decimal, first, width, names, units, row, between)


def _header(line: str, separator: str, width: int, trailing: bool) -> tuple[str, ...] | None:
    """The names in a header line, as many as rows have fields; None where the line is no header.
    trailing : whether rows end with an empty field."""
    if len(line) > _LONGEST_HEADER:
        return None
    text = line
    marked = next((mark for mark in MARKS if text.lstrip().startswith(mark)), None)
    if marked is not None and marked != separator:
        text = text.lstrip().lstrip("".join(MARKS)).strip()
    splits = [fields(text, separator)] if separator != _BLANKS else []
    splits += [fields(text, other) for other in ("\t", ";", ",") if other in text]
    splits.append(re.split(r"\s{2,}|\t", text.strip()))
    splits.append([word.strip('"') for word in _WITH_UNIT.findall(text)])
    splits.append(fields(text, _BLANKS))
    for found in splits:
        words = [field.strip() for field in found]
        if len(words) == width + 1 and not words[-1]:
            words = words[:-1]
        if len(words) == width - 1 and width > 2:
            words = [*words, ""] if trailing else ["", *words]
        numbers = sum(is_number(w, ".") or is_number(w, ",") for w in words)
        lettered = sum(any(c.isalpha() for c in w) for w in words)
        if len(words) == width and numbers == 0 and lettered >= max(1, width // 2):
            return tuple(words)
    return None
