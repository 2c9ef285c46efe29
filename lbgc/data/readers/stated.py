"""The sample rate that a file's comments or preamble state, such as `// Update Rate: 100.0Hz`."""

import re
from collections.abc import Iterable

_NUMBER = r"(\d+(?:[.,]\d+)?(?:[eE][+-]?\d+)?)"
_RATE = re.compile(
    r"(?:rate|frequency|freq|odr|fs|f_s)\b[^0-9\n]{0,30}?" + _NUMBER + r"\s*(k?hz|sps|samples?/s)?",
    re.I,
)
_INTERVAL = re.compile(
    r"(?:delta[_ ]?[xt]|interval|period|sample time|dt)\b[^0-9\n]{0,20}?"
    + _NUMBER
    + r"\s*(s|ms|us)?\b",
    re.I,
)
_OF_FILTERS = re.compile(r"filter|bandwidth|cut-?off|baud|lpf|notch", re.I)
_LONGEST = 500
"""Characters of a line that are looked at."""
_INTERVAL_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}


def stated_rate(lines: Iterable[str]) -> float | None:
    """The sample rate that lines of comments state, Hz; None where they state none, or several that
    differ."""
    found = set()
    for line in lines:
        text = line[:_LONGEST]
        if _OF_FILTERS.search(text):
            continue
        rate = _RATE.search(text)
        interval = _INTERVAL.search(text)
        if rate:
            found.add(_value(rate[1]) * (1e3 if (rate[2] or "").lower() == "khz" else 1.0))
        elif interval and _value(interval[1]) > 0:
            found.add(1 / (_value(interval[1]) * _INTERVAL_UNITS[(interval[2] or "s").lower()]))
    plausible = {rate for rate in found if 0.1 <= rate <= 1e5}
    return plausible.pop() if len(plausible) == 1 else None


def _value(text: str) -> float:
    """A number with a decimal point or comma."""
    return float(text.replace(",", "."))
