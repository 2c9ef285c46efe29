"""What a table of a file is and which of its columns are what, in words."""

from lbgc.data.looking import columns
from lbgc.data.readers.formats.table import Collected, Frame
from lbgc.data.readers.sheets import Sheet, shown

_SEPARATORS = {" ": "blanks", "\t": "tabs", ",": "commas", ";": "semicolons", "|": "bars"}


def kind(own: Sheet) -> str:
    """What kind of file it is, a plain sentence."""
    if isinstance(own.source, Collected):
        table = own.source.table
        return f"table {shown(table.name)}, of {table.rows} rows and {own.width} columns"
    dialect = getattr(own.source, "layout", None)
    if dialect is None:
        return f"a Parquet file of {own.width} columns"
    header = "a header" if own.has_header else "no header"
    units = " and a row of units" if own.units else ""
    before = f", its rows from line {dialect.first + 1} on" if dialect.first > 1 else ""
    mark = ", with decimal commas" if dialect.decimal == "," else ""
    separator = _SEPARATORS.get(dialect.separator, dialect.separator)
    return f"text of {own.width} columns between {separator}{mark}, {header}{units}{before}"


def frame(own: Sheet) -> Frame | None:
    """The axes that the table's format states; None where it states none."""
    return own.source.table.frame if isinstance(own.source, Collected) else None


def which(own: Sheet, found: columns.Columns) -> str:
    """Which columns are what, a plain sentence."""
    parts = [
        f"{what} {', '.join(columns.named(own, one) for one in at)}"
        for what, at in (
            ("gyro", found.gyro),
            ("accelerometer", found.accel),
            ("time", found.time),
        )
        if at
    ]
    return "; ".join(parts)
