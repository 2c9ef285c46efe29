"""Fit a sensor's noise to its own static log, or to a dataset.

python lbgc/fit.py log=csv log.path=mine.csv log.latitude=48.1 name=mine
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from lbgc import calibrate
from lbgc.data import logs
from lbgc.data.store import Dataset
from lbgc.errors import InputError, require, require_positive, run_main
from lbgc.outputs import fingerprint, mark_latest, task_directory, write_atomically
from lbgc.report.allan_page import AllanData, draw
from lbgc.sensor.calibration import Calibration
from lbgc.sensor.fitting import Estimate, Fit, choose
from lbgc.sensor.ordinates import pooled
from lbgc.units import factor, unit_of

AXES = ("forward", "right", "down")
# parameter -> the key of `conf/imu/`, for a gyro and for an accelerometer
KEYS = {
    "N": ("arw_deg_per_sqrt_h", "vrw_m_per_s_per_sqrt_h"),
    "B": ("bias_instability_deg_per_h", "bias_instability_ug"),
    "K": ("rrw_deg_per_h_per_sqrt_h", "random_walk_ug_per_sqrt_h"),
    "Q": ("quantisation_arcsec", "quantisation_ug_s"),
    "ramp": ("ramp_deg_per_h_per_h", "ramp_ug_per_h"),
    "GM_sigma": ("gauss_markov_deg_per_h", "gauss_markov_ug"),
    "GM_T": ("gauss_markov_s", "gauss_markov_s"),
    "line_sigma": ("deg_per_h", "ug"),
    "line_f0": ("hz", "hz"),
    "line_width": ("width_hz", "width_hz"),
    "bandwidth": ("bandwidth_hz", "bandwidth_hz"),
    "damping": ("filter_damping", "filter_damping"),
    "tone": ("tone_deg_per_h", "tone_ug"),
    "tone_f": ("tone_hz", "tone_hz"),
}
WORDS = {
    "N": "angle (velocity) random walk",
    "B": "bias instability",
    "K": "rate random walk",
    "Q": "quantisation",
    "ramp": "linear drift",
    "GM_sigma": "Gauss-Markov process",
    "GM_T": "its correlation time",
    "line_sigma": "narrow-band line, rms",
    "line_f0": "its frequency",
    "line_width": "its width",
    "bandwidth": "output filter",
    "damping": "its damping",
}
SHORTEST_S = 60.0
_EIGHTHS = 8
_STEADY = 3.0


@dataclass(frozen=True)
class FitConfig:
    """What `conf/fit.yaml` holds."""

    log: logs.LogConfig | None = None
    """A static log."""
    data: str | None = None
    """Or a dataset of resting recordings, whose noise is pooled."""
    name: str = "mine"
    """Of the fitted sensor: `imu=NAME`."""
    flicker_short_s: float = 1.0
    """Corners of the bias instability's flat floor; a log says little about them."""
    flicker_long_s: float = 3600.0
    """The longer one."""

    def __post_init__(self) -> None:
        one = (self.data is None) != (self.log is None)
        given = "both" if self.log is not None else "nothing"
        require(one, "data or log", given, "give one: log=NAME, or data=PATH")
        require(self.name.isidentifier(), "name", self.name, "must be a plain word")
        require_positive("flicker_short_s", self.flicker_short_s)
        require(
            self.flicker_long_s > self.flicker_short_s,
            "flicker_long_s",
            self.flicker_long_s,
            f"must be above flicker_short_s = {self.flicker_short_s:g}",
        )


@dataclass(frozen=True)
class Static:
    """Resting recordings of one length: gyro and accel (R, n, 3), SI."""

    name: str
    gyro: np.ndarray
    accel: np.ndarray
    dt: float
    latitude: float
    heading: np.ndarray | None
    """(R,), rad, where every recording's is known"""
    session: np.ndarray | None
    """(R,), which power-up each is from, where that is known"""


def main(config: FitConfig) -> Path:
    """Fit every axis, print what was found, write the sensor and its plots; return their folder."""
    static = _read(config)
    _check_static(static)
    corners = (config.flicker_short_s, config.flicker_long_s)
    fits: dict[str, list[Fit]] = {}
    for part in tqdm(("gyro", "accel"), "fitting", leave=False):
        series = getattr(static, part)
        fits[part] = [choose(pooled(series[:, :, axis], static.dt), corners) for axis in range(3)]
    directory = task_directory("fit", fingerprint({**asdict(config), "of": static.name}))
    (directory / "imu").mkdir(exist_ok=True)
    print(report(static, fits))
    calibration = None
    if static.heading is not None and len(static.heading) >= calibrate.FEWEST:
        rates = static.gyro.mean(axis=1)
        calibration = calibrate.calibrate(rates, static.heading, static.latitude, static.session)
        print(calibrate.report(calibration, static.name))
    yaml = sensor_yaml(config, static, fits, calibration)
    write_atomically(directory / "imu" / f"{config.name}.yaml", yaml)
    write_atomically(directory / "fit.json", json.dumps(_as_json(fits), indent=2) + "\n")
    for part in ("gyro", "accel"):
        data = AllanData(part, getattr(static, part), static.dt, static.latitude)
        for name, figure in draw(data, fits[part]).items():
            figure.savefig(directory / f"{name}.png", dpi=130)
    mark_latest(directory)
    print("use it:")
    print(f"python sim/generate.py --config-dir {directory} imu={config.name}")
    return directory


def _read(config: FitConfig) -> Static:
    session = None
    if config.log is not None:
        records = list(logs.read(config.log, north=False))
        name = config.log.name
    else:
        assert config.data is not None
        dataset = Dataset.open_finished(config.data)
        records = list(dataset.records(np.arange(min(len(dataset), 64))))
        session = dataset.label("session")[: len(records)]
        name = str(dataset.path)
    still = all(np.ptp(r.plate_angle) < 1e-4 for r in records)
    require(still, "data", name, "has a plate that turns; noise is fitted to resting recordings")
    headings = [r.heading_reference for r in records]
    n = min(len(r.gyro) for r in records)
    seconds = n / records[0].rate_hz
    if seconds < SHORTEST_S:
        raise InputError(
            name, f"{seconds:g}", "s", f"is too short to tell noise from bias; {SHORTEST_S:g} s "
            "at the least, and an hour to see a bias instability"
        )  # fmt: skip
    return Static(
        name,
        np.stack([r.gyro[:n] for r in records]),
        np.stack([r.accel[:n] for r in records]),
        1 / records[0].rate_hz,
        records[0].latitude,
        None if any(h is None for h in headings) else np.array(headings, dtype=float),
        session,
    )


def _check_static(static: Static) -> None:
    """Raise InputError where the recording is not one steady state: a resting IMU's differences
    between neighbours (samples, means over 0.1 s, over 1 s) have one power throughout. Over 50
    differences each, the powers of eight steady stretches are within a factor of three."""
    for part in ("gyro", "accel"):
        still = np.ptp(getattr(static, part), axis=1).min(axis=0)
        if not still.all():
            axis = AXES[int(np.argmin(still))]
            raise InputError(
                static.name,
                f"{part} {axis}",
                "",
                "never changes: a dead channel has no noise to fit",
            )
    for part, seconds in ((p, s) for p in ("gyro", "accel") for s in (static.dt, 0.1, 1.0)):
        block = max(1, round(seconds / static.dt))
        series = getattr(static, part)
        count = series.shape[1] // block
        if count < _EIGHTHS * 50:
            continue
        means = series[:, : count * block].reshape(len(series), count, block, 3).mean(axis=2)
        eighths = np.array_split(np.diff(means, axis=1), _EIGHTHS, axis=1)
        power = np.array([np.mean(e**2, axis=(0, 1)) for e in eighths])
        ratio = float(np.max(power.max(axis=0) / np.maximum(power.min(axis=0), 1e-300)))
        if ratio > _STEADY:
            raise InputError(
                static.name, f"{ratio:.3g}", "", f"times as much {part} noise in one eighth of the "
                "log as in another: something moved, or shook it; noise is fitted to a resting "
                "IMU, so cut the log to a quiet stretch"
            )  # fmt: skip


def every_estimate(fit: Fit) -> dict[str, Estimate]:
    return {**fit.estimates, "ramp": fit.ramp}


def report(static: Static, fits: dict[str, list[Fit]]) -> str:
    """What was found, as a person reads it."""
    n = static.gyro.shape[1] * static.dt
    lines = [f"{static.name}: {len(static.gyro)} recording(s) of {n:g} s at {1 / static.dt:g} Hz"]
    for which, part in enumerate(("gyro", "accel")):
        for axis, fit in zip(AXES, fits[part], strict=True):
            lines.append(f"{part} {axis}")
            for name, e in every_estimate(fit).items():
                plain = _unnumbered(name)
                lines.append(f"  {WORDS[plain]:30s} {_spelled(e, KEYS[plain][which])}")
            for tone in fit.tones:
                size = tone.amplitude / factor(KEYS["tone"][which])
                unit = unit_of(KEYS["tone"][which])
                lines.append(f"  {'tone':30s} {size:.3g} {unit} at {tone.f:.4g} Hz")
    return "\n".join(lines)


def _spelled(e: Estimate, key: str) -> str:
    scale, unit = _scale(key), f" {unit_of(key)}".rstrip()
    if e.is_limit:
        return (
            f"below {e.upper / scale:.3g}{unit} (95%); this log cannot tell it from zero, a longer "
            "one may"
        )
    return f"{e.value / scale:.4g}{unit}, 95% {e.low / scale:.4g} to {e.high / scale:.4g}"


def sensor_yaml(
    config: FitConfig,
    static: Static,
    fits: dict[str, list[Fit]],
    calibration: Calibration | None = None,
) -> str:
    """The fitted sensor as `conf/imu/` holds them; what cannot be told from zero is zero."""
    seconds = static.gyro.shape[1] * static.dt
    lines = [
        f"# Fitted by lbgc to {static.name}: {len(static.gyro)} x {seconds:g} s at "
        f"{1 / static.dt:g} Hz.",
        "# Each line: forward, right, down; 95% intervals behind. What the log cannot tell from",
        "# zero is zero, with its 95% upper limit behind. Biases need recordings with known",
        "# headings.",
        f"name: {config.name}",
    ]
    for which, part in enumerate(("gyro", "accel")):
        lines.append(f"{part}:")
        lines += [
            f"  flicker_short_s: {config.flicker_short_s:g}",
            f"  flicker_long_s: {config.flicker_long_s:g}",
        ]
        for name in KEYS:
            if not name.startswith("line_"):
                lines += _yaml_line(name, which, fits[part])
        lines += _yaml_of_lines(which, fits[part])
        if part == "gyro" and calibration is not None:
            lines += _bias_lines(calibration)
    return "\n".join(lines) + "\n"


def _yaml_line(name: str, which: int, fits: list[Fit]) -> list[str]:
    key = KEYS[name][which]
    scale = _scale(key)
    if name in ("tone", "tone_f"):
        largest = [max(f.tones, key=lambda t: t.amplitude, default=None) for f in fits]
        if not any(largest):
            return []
        values = [0.0 if t is None else t.amplitude / scale for t in largest]
        if name == "tone_f":
            values = [1.0 if t is None else t.f for t in largest]
        return [f"  {key}: [{', '.join(map(_number, values))}]"]
    found = [every_estimate(f).get(name) for f in fits]
    if not any(found):
        return []
    return [_figures(f"  {key}", name, found, scale)]


_NEUTRAL = {"GM_T": 1.0, "line_f0": 1.0, "line_width": 1.0, "bandwidth": 1e6, "damping": 1.0}


def _figures(start: str, name: str, found: list[Estimate | None], scale: float) -> str:
    """`key: [x, y, z]  # intervals`; an axis that has no such part has a neutral figure."""
    neutral = _NEUTRAL.get(name, 0.0)
    told = [neutral if e is None else 0.0 if e.is_limit else e.value / scale for e in found]
    ranges = [
        "-" if e is None
        else f"<{e.upper / scale:.3g}" if e.is_limit
        else f"{e.low / scale:.3g}..{e.high / scale:.3g}"
        for e in found
    ]  # fmt: skip
    return f"{start}: [{', '.join(map(_number, told))}]  # {', '.join(ranges)}"


def _number(value: float) -> str:
    """Six digits, as every YAML reader takes them: 1.0e-05, since 1e-05 is a text to some."""
    text = f"{value:.6g}"
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


def _yaml_of_lines(which: int, fits: list[Fit]) -> list[str]:
    """Every axis's lines, the first ones of each together, and so on."""
    own = [[n for n in every_estimate(f) if n.startswith("line_sigma")] for f in fits]
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
            out.append(_figures(start, name, found, _scale(key)))
    return ["  lines:", *out] if out else []


def _unnumbered(name: str) -> str:
    """A parameter's name without the number that tells a model's lines apart."""
    return name.rstrip("_0123456789") if name not in KEYS else name


def _scale(key: str) -> float:
    """SI per unit of the key; a key without a unit is a plain number."""
    return factor(key) if unit_of(key) else 1.0


def _bias_lines(c: Calibration) -> list[str]:
    """Bias by lifetime: this unit's own, as the 1 sigma of units like it, and the scatter."""
    session = np.zeros(3) if c.session_sigma is None else c.session_sigma
    return [
        f"  {key}: [{', '.join(f'{v:.4g}' for v in values / factor(key))}]{comment}"
        for key, values, comment in (
            ("bias_unit_deg_per_h", np.abs(c.bias), "  # this unit"),
            ("bias_session_deg_per_h", session, ""),
            ("bias_run_deg_per_h", c.run_sigma, ""),
        )
    ]


def _as_json(fits: dict[str, list[Fit]]) -> dict:
    """Every estimate in SI, and the tones."""
    return {
        part: [
            {
                "estimates": {n: asdict(e) for n, e in every_estimate(fit).items()},
                "tones": [asdict(t) for t in fit.tones],
                "bic": fit.bic,
            }
            for fit in axes
        ]
        for part, axes in fits.items()
    }


if __name__ == "__main__":
    run_main(main, FitConfig, "fit")
