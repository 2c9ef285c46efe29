"""The fitted sensor as a YAML file of the form of `conf/imu/`."""

import re
from collections.abc import Iterator, Sequence

import numpy as np

from lbgc.data.static import PARTS, Static
from lbgc.outputs import as_json
from lbgc.report.fitted import KEYS, every_estimate, scale_of
from lbgc.report.fitted_beside import Beside, Warmth, beside, number, unmeasured, whole
from lbgc.sensor.calibration import Calibration
from lbgc.sensor.fitting.bias_size import BiasSize
from lbgc.sensor.fitting.noise_fit import Fit
from lbgc.sensor.fitting.profile import FittedParameter
from lbgc.sensor.fitting.shapes import is_line, poles
from lbgc.units import factor


def sensor_yaml(
    name: str,
    statics: Sequence[Static],
    fits: dict[str, list[Fit]],
    calibration: Calibration | None = None,
    sizes: dict[str, BiasSize] | None = None,
    warmth: Warmth | None = None,
) -> str:
    """The content of the fitted sensor's YAML file; parameters that cannot be told from zero are
    zero there.

    name : the sensor's; statics : the recordings, one for each clock; calibration : of the gyros,
    where the recordings allow one; sizes : of the biases of gyro and accel, where a mean alone
    tells them; warmth : what temperature told. A triad that was not recorded has no errors here,
    which `assumed` says wherever the sensor is used.
    """
    about = [
        *(
            f"# Fitted by lbgc to {own.name}{_whose(own, statics)}: {own.shape[0]} x "
            f"{own.shape[1] * own.dt:g} s at {1 / own.dt:g} Hz."
            for own in statics
        ),
        "# Each line: forward, right, down; 95% intervals behind. What the log cannot tell from",
        "# zero is zero, with its 95% upper limit behind. A single recording tells biases by its",
        "# mean alone, and not how long they last: recordings with known headings do.",
    ]
    said = [f"# {sentence}." for part, own in fits.items() if (sentence := unmeasured(part, own))]
    three = {part: whole(own, own) for part, own in fits.items()}
    told = {part: whole(own, fits[part]) for part, own in (warmth or {}).items()}
    more = beside(three, sizes, told, [own[2:] for own in said])
    return _yaml(name, [*about, *said], three, more, calibration)


def _whose(own: Static, statics: Sequence[Static]) -> str:
    """Whose samples a recording has, where there are several clocks."""
    return f", its {' and '.join(own.triads)}" if len(statics) > 1 else ""


def curve_yaml(name: str, of: str, fits: dict[str, list[Fit]]) -> str:
    """The content of the YAML file of a sensor that was fitted to Allan curves; a triad that has
    none is left out. of : the curves, in words."""
    about = [
        f"# Fitted by lbgc to {of}.",
        "# Each line: forward, right, down; 95% intervals behind. What the curve cannot tell from",
        "# zero is zero, with its 95% upper limit behind. A curve tells nothing of biases.",
        *(f"# No curve of its {part}: without noise here." for part in PARTS if part not in fits),
    ]
    return _yaml(name, about, fits, beside(fits))


def _yaml(
    name: str,
    about: list[str],
    fits: dict[str, list[Fit]],
    more: Beside,
    calibration: Calibration | None = None,
) -> str:
    """The content of a fitted sensor's YAML file. about : the comments at its top; more : what
    stands beside the noise terms."""
    lines = [*about, f"name: {as_json(name)}", *more.top]
    for which, part in enumerate(PARTS):
        if part not in fits:
            continue
        lines.append(f"{part}:")
        lines += [
            f"  flicker_short_s: {fits[part][0].corners[0]:g}",
            f"  flicker_long_s: {fits[part][0].corners[1]:g}",
        ]
        for parameter in KEYS:
            if not parameter.startswith("line_"):
                lines += _yaml_line(parameter, which, fits[part])
        lines += _yaml_of_lines(which, fits[part])
        if part == "gyro" and calibration is not None:
            lines += _bias_lines(calibration)
        lines += more.triads[part]
    return "\n".join(lines) + "\n"


def intervals(yaml: str) -> Iterator[str]:
    """The lines of a fitted sensor's YAML file that have intervals behind them, each with its
    triad's name in front; those of narrow-band lines are left out."""
    part = ""
    for line in yaml.splitlines():
        part = line.removesuffix(":") if line.endswith(":") and line[0] != " " else part
        if re.match(r"  \w.*  # ", line):
            yield f"fitted, 95% intervals behind: {part}.{line.strip()}"


def _yaml_line(name: str, which: int, fits: list[Fit]) -> list[str]:
    """The line for one parameter of a triad, or none where no axis has it. which : 0 for gyro, 1
    for accel."""
    key = KEYS[name][which]
    scale = scale_of(key)
    if name in ("tone", "tone_f"):
        largest = [max(f.tones, key=lambda t: t.amplitude, default=None) for f in fits]
        if not any(largest):
            return []
        values = [0.0 if t is None else t.amplitude / scale for t in largest]
        if name == "tone_f":
            values = [1.0 if t is None else t.f for t in largest]
        return [f"  {key}: [{_numbers(values)}]"]
    found = [every_estimate(f).get(name) for f in fits]
    if not any(found):
        return []
    return [_figures(f"  {key}", name, found, scale)]


_NEUTRAL = {"GM_T": 1.0, "line_f0": 1.0, "line_width": 1.0, "bandwidth": 1e6, "damping": 1.0}


def _figures(start: str, name: str, found: list[FittedParameter | None], scale: float) -> str:
    """The line `key: [x, y, z]  # intervals`; an axis without the parameter has a neutral value."""
    neutral = _NEUTRAL.get(name, 0.0)
    is_size = name not in _NEUTRAL  # others shape a term, and are kept at the end of their range
    told = [
        neutral if e is None
        else 0.0 if e.is_limit and is_size and not (e.is_withheld and name == "N")
        else e.value / scale
        for e in found
    ]  # fmt: skip
    ranges = ["-" if e is None else _range(e, scale) for e in found]
    return f"{start}: [{_numbers(told)}]  # {', '.join(ranges)}"


def _numbers(values: list[float]) -> str:
    """Values with six digits, separated by commas."""
    return ", ".join(number(value, 6) for value in values)


def _range(e: FittedParameter, scale: float) -> str:
    """An estimate's 95% interval, or its limit, as the comment behind a value. scale : SI per unit
    of the key."""
    if e.is_withheld:
        return "cannot be told"
    if e.is_limit:
        return f"<{e.upper / scale:.3g}"
    if e.is_lower_limit:
        return f">{e.low / scale:.3g}"
    if e.low == e.high:
        return "given"
    return f"{e.low / scale:.3g}..{e.high / scale:.3g}"


def _yaml_of_lines(which: int, fits: list[Fit]) -> list[str]:
    """The entry for a triad's narrow-band lines: the first lines of all axes together, then the
    second ones, and so on."""
    own = [[n for n in every_estimate(f) if n.startswith("line_sigma")] for f in fits]
    shapes = [[s for s in f.shapes if is_line(s)] for f in fits]
    out = []
    for k in range(max(map(len, own))):
        for name in ("line_sigma", "line_f0", "line_width"):
            found = [
                every_estimate(fit).get(names[k].replace("line_sigma", name)) if k < len(names)
                else None
                for fit, names in zip(fits, own, strict=True)
            ]  # fmt: skip
            key = KEYS[name][which]
            start = f"    {'- ' if name == 'line_sigma' else '  '}{key}"
            out.append(_figures(start, name, found, scale_of(key)))
        kinds = [poles(s[k]) if k < len(s) else 2 for s in shapes]
        out.append(f"      poles: {kinds}")
    return ["  lines:", *out] if out else []


def _bias_lines(c: Calibration) -> list[str]:
    """The lines for the gyro bias by lifetime: the size of this unit's own bias, as the 1 sigma of
    units like it, and the scatter between sessions and between runs."""
    session = np.zeros(3) if c.session_sigma is None else c.session_sigma
    return [
        f"  {key}: [{', '.join(f'{v:.4g}' for v in values / factor(key))}]{comment}"
        for key, values, comment in (
            ("bias_unit_deg_per_h", np.abs(c.bias), "  # this unit"),
            ("bias_session_deg_per_h", session, ""),
            ("bias_run_deg_per_h", c.run_sigma, ""),
        )
    ]
