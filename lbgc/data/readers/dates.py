"""Times of day and dates as people write them, converted to nanoseconds for their differences."""

import re
from collections.abc import Sequence
from datetime import date

import numpy as np

_FIRST_DAY = date(2000, 1, 1).toordinal()
_WRITTEN = re.compile(
    r"(?:(?P<y>\d{4})[-/.](?P<m>\d{1,2})[-/.](?P<d>\d{1,2})[ T,]+"
    r"|(?P<d2>\d{1,2})\.(?P<m2>\d{1,2})\.(?P<y2>\d{4})[ T,]+)?"
    r"(?P<h>\d{1,2}):(?P<min>\d{2}):(?P<s>\d{2})(?:[.,:](?P<f>\d{1,9}))?"
    r"(?: ?(?:Z|UTC|GMT|[+-]\d{2}:?\d{2}))?"
)


def nanoseconds(texts: Sequence[str] | np.ndarray) -> np.ndarray | None:
    """Times such as 26.11.2026 12:00:00,010 or 12:00:00.010 in ns since midnight, or since the year
    2000 where they have dates: (T,), int64. None where one of the texts is no time. Time zones are
    ignored, since a log has only one."""
    days: dict[tuple[int, int, int], int] = {}
    found = np.empty(len(texts), dtype=np.int64)
    for at, text in enumerate(texts):
        parts = _WRITTEN.fullmatch(text.strip().strip('"')) if isinstance(text, str) else None
        if parts is None:
            return None
        year = parts["y"] or parts["y2"]
        day = 0
        if year is not None:
            key = int(year), int(parts["m"] or parts["m2"]), int(parts["d"] or parts["d2"])
            try:
                if key not in days:
                    days[key] = date(*key).toordinal() - _FIRST_DAY
            except ValueError:
                return None
            day = days[key]
        seconds = int(parts["h"]) * 3600 + int(parts["min"]) * 60 + int(parts["s"])
        fraction = int((parts["f"] or "0").ljust(9, "0"))
        found[at] = (day * 86400 + seconds) * 10**9 + fraction
    return found
