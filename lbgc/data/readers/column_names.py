"""The meaning of a file's column names: the sensor and axis, the unit, and which is the time."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

_BRACKETS = re.compile(r"^(.*?)[\s_]*[(\[{<]([^)\]}>]*)[)\]}>]\s*$")
_WORDS = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+|[^\W\d_]+")

_LONGEST = 200
"""Characters of a name that is looked at, at most."""

_PLAIN = 3
"""Letters from which on a gyro's name needs no unit: g may be gravity."""

_UNITS = {
    "rad/s": "rad/s", "rads": "rad/s", "rad/sec": "rad/s", "rps": "rad/s", "radps": "rad/s",
    "deg/s": "deg/s", "degs": "deg/s", "deg/sec": "deg/s", "dps": "deg/s", "degps": "deg/s",
    "deg/h": "deg/h", "deg/hr": "deg/h", "deg/hour": "deg/h", "dph": "deg/h",
    "mrad/s": "mrad/s",
    "rad": "rad", "deg": "deg", "arcsec": "arcsec",
    "m/s2": "m/s2", "m/s/s": "m/s2", "m/ss": "m/s2", "mps2": "m/s2", "ms2": "m/s2",
    "m/sec2": "m/s2", "g": "g", "gs": "g", "mg": "mg",
    "m/s": "m/s", "g*s": "g*s", "ug*s": "ug*s",
    "s": "s", "sec": "s", "secs": "s", "second": "s", "seconds": "s",
    "ms": "ms", "msec": "ms", "millis": "ms", "millisecond": "ms", "milliseconds": "ms",
    "us": "us", "usec": "us", "micros": "us", "microsecond": "us", "microseconds": "us",
    "ns": "ns", "nsec": "ns", "nanos": "ns", "nanosecond": "ns", "nanoseconds": "ns",
    "min": "min", "mins": "min", "minutes": "min", "h": "h", "hr": "h", "hours": "h",
    "d": "d", "days": "d",
}  # fmt: skip
_DIMENSIONS = {
    "gyro": {"rad/s", "deg/s", "deg/h", "mrad/s", "rad", "deg", "arcsec"},
    "accel": {"m/s2", "g", "mg", "m/s", "g*s", "ug*s"},
    "time": {"s", "ms", "100us", "us", "ns", "min", "h", "d"},
}
_SUFFIXES = {
    ("rad", "s"): "rad/s", ("rad", "per", "s"): "rad/s", ("rps",): "rad/s",
    ("deg", "s"): "deg/s", ("deg", "per", "s"): "deg/s", ("dps",): "deg/s",
    ("deg", "h"): "deg/h", ("deg", "per", "h"): "deg/h", ("mrad", "s"): "mrad/s",
    ("m", "s", "2"): "m/s2", ("m", "s2"): "m/s2", ("m", "per", "s", "2"): "m/s2",
    ("mps", "2"): "m/s2", ("ms", "2"): "m/s2",
}  # fmt: skip
"""Units at the end of a name, as its last words."""
_KINDS = {
    "gyro": "g w wb wib wibb gyr gyro gyros gyroscope omega angularvelocity angularvel angvel "
    "angularrate angrate rotationrate rotrate rate rates gyrorate turnrate gyrorotation",
    "accel": "a f fb fib fibb acc accel accels accelerometer accelerometers acceleration "
    "linearacceleration linacc linaccel specificforce sf force accelerometeracceleration",
}  # fmt: skip
_KIND_OF = {word: kind for kind, words in _KINDS.items() for word in words.split()}
_NOISE = re.compile(
    "imu|sensor|raw|cal|calib|calibrated|comp|compensated|uncomp|field|data|rs|s|b|ib|out|output|"
    "value|val|meas|measured|body|si|group|msg|header"
)
_TIMES = re.compile(
    "t|times?|zeit|zeitstempel|temps|tiempo|timestamps?|stamp|elapsed|seconds|secs?|secondselapsed|elapsedtime|timeelapsed|"
    "sampletime|sampletimefine|sensortime|sys(tem)?time|unixtime|epoch(time)?|timestart(up)?|"
    "timesincestart(up)?|timesyncin|tow|gpstow|gpstime|timegps|timeofweek|utc|utctime|datetime|"
    "rostime|millis|micros|timeboot|loggingtime|timestampsincestart"
)

_PARTS = re.compile("(utc|gmt|local)(year|month|day|hour|minute|second|mill[ie]second|microsecond)")
"""Parts of a date, which no column of times is by itself."""


@dataclass(frozen=True)
class Described:
    """The meaning of a column by its name; None where the name does not state it."""

    kind: str | None
    """gyro, accel or time"""
    axis: str | None
    """x, y or z"""
    unit: str | None
    """The unit, as it is called here"""


def unit(text: str) -> str | None:
    """The name that a unit has here, for the ways in which people write it ("°/s", "rad s^-1",
    "m/s²"); None where the text is no unit that is known."""
    plain = text.strip().strip("()[]{}<>").strip().replace("\N{MICRO SIGN}", "u")
    plain = plain.replace("\N{GREEK SMALL LETTER MU}", "u").replace("\N{DEGREE SIGN}", "deg")
    plain = plain.replace("\N{SUPERSCRIPT TWO}", "2").replace("\N{SUPERSCRIPT ONE}", "1")
    plain = plain.replace("\N{SUPERSCRIPT MINUS}", "-").replace("degrees", "deg")
    plain = plain.replace("\N{MIDDLE DOT}", " ").lower().replace("**", "^").strip()
    plain = re.sub(r"\s*/\s*", "/", plain)
    found = re.fullmatch(r"([a-z]+)[\s*./]*(s|sec|h)\s*\^?\(?-(\d)\)?", plain)
    if found:
        plain = f"{found[1]}/{found[2]}" + ("" if found[3] == "1" else found[3])
    plain = plain.replace("^", "").replace("(", "").replace(")", "").replace(" per ", "/")
    return _UNITS.get(plain.replace(" ", ""))


def described(name: str, units_row: str = "") -> Described:
    """The meaning of a column by its name, and by the text beneath it in a row of units, if there
    is one."""
    if len(name) > _LONGEST:
        return Described(None, None, None)
    base, said = name, unit(units_row[:_LONGEST]) if units_row else None
    found = _BRACKETS.match(name)
    if found and said is None:
        base, said = found[1], unit(found[2])
    base = base.replace("\N{GREEK SMALL LETTER OMEGA}", "w")
    words = [word.lower() for word in _WORDS.findall(base)]
    if _PARTS.fullmatch("".join(words)):
        return Described(None, None, None)
    words, suffix = _without_unit(words)
    said = said or suffix
    joined = "".join(words)
    if said is None and joined == "sampletimefine":
        return Described("time", None, "100us")
    bare = "".join(word for word in words if not _NOISE.fullmatch(word))
    if joined == "xvalue" or _TIMES.fullmatch(joined) or _TIMES.fullmatch(bare):
        of_time = said if said in _DIMENSIONS["time"] else None
        return Described("time", None, of_time if said else _in_name(joined))
    kind, axis = _vector(words)
    if kind is None or (said is not None and said not in _DIMENSIONS[kind]):
        return Described(None, None, said)
    return Described(kind, axis, said)


def _in_name(joined: str) -> str | None:
    """The unit in the name of a time column that is itself a unit, such as seconds or millis."""
    if joined.startswith("seconds"):
        return "s"
    return _UNITS.get(joined) if joined not in ("t", "s", "d", "h") else None


def _without_unit(words: list[str]) -> tuple[list[str], str | None]:
    """A name's words without a unit at the end, and that unit."""
    for suffix, said in _SUFFIXES.items():
        if len(words) > len(suffix) and tuple(words[-len(suffix) :]) == suffix:
            return words[: -len(suffix)], said
    if len(words) > 2 and words[-2] == "in" and words[-1] in _UNITS:
        return words[:-2], _UNITS[words[-1]]
    last = words[-1] if len(words) > 1 else ""
    before = "".join(words[:-1])
    is_time = (
        last in _UNITS
        and _TIMES.fullmatch(before) is not None
        and _UNITS[last] in _DIMENSIONS["time"]
    )
    is_force = last in ("g", "gs", "mg") and len(words) > 2
    if is_time or is_force:
        return words[:-1], _UNITS[last]
    return words, None


def _vector(words: Sequence[str]) -> tuple[str | None, str | None]:
    """The sensor (gyro or accel) and the axis that a name's words state; None for both where they
    do not."""
    kept = [word for word in words if not _NOISE.fullmatch(word) and not word.isdigit()]
    axes = [word for word in kept if word in ("x", "y", "z")]
    if len(axes) == 1:
        rest = "".join(word for word in kept if word not in axes)
        return (_KIND_OF[rest], axes[0]) if rest in _KIND_OF else (None, None)
    joined = "".join(kept)
    if not axes and len(joined) > 1:
        if joined[-1] in "xyz" and joined[:-1] in _KIND_OF:
            return _KIND_OF[joined[:-1]], joined[-1]
        if joined[0] in "xyz" and joined[1:] in _KIND_OF:
            return _KIND_OF[joined[1:]], joined[0]
    return None, None


def is_gyro(name: str, units_row: str = "") -> bool:
    """Whether a name without an axis, such as rate (deg/h), is that of a gyro."""
    found = _BRACKETS.match(name[:_LONGEST])
    said = unit(units_row[:_LONGEST]) or (unit(found[2]) or found[2] if found else None)
    words = [word.lower() for word in _WORDS.findall(found[1] if found else name[:_LONGEST])]
    words, suffix = _without_unit(words)
    said = said or suffix
    joined = "".join(word for word in words if not _NOISE.fullmatch(word) and not word.isdigit())
    plain = len(joined) >= _PLAIN or said in _DIMENSIONS["gyro"]
    return _KIND_OF.get(joined) == "gyro" and plain and said in (None, *_DIMENSIONS["gyro"])


def seconds_and_nanoseconds(names: Sequence[str]) -> tuple[int, int] | None:
    """The positions of the two columns of a time in whole seconds and nanoseconds, as ROS prints
    it; None where there are no such columns."""
    flat = ["".join(word.lower() for word in _WORDS.findall(name)) for name in names]
    pairs = []
    for first, second in (("secs", "nsecs"), ("sec", "nanosec"), ("sec", "nsec")):
        for at, name in enumerate(flat):
            if name.endswith(first) and name.removesuffix(first) + second in flat:
                pairs.append((at, flat.index(name.removesuffix(first) + second)))
    return pairs[0] if pairs else None
