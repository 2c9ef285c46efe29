"""A sensor as Gazebo simulates it: the noise of an SDF `<sensor type="imu">`, for gz-sensors.

A sample is truth + bias + Normal(mean, stddev), where stddev is of one sample, so N/sqrt(dt): it
belongs to the update rate. The bias is drawn from Normal(bias_mean, bias_stddev) at the start, and
turned round with even odds. With a dynamic bias it then goes on as

    bias = e^(-dt/T) bias + Normal(0, q^2 T/2 (1 - e^(-2 dt/T))),

q the dynamic_bias_stddev and T the dynamic_bias_correlation_time (gz-sensors,
src/GaussianNoiseModel.cc, ApplyImpl). So q is no standard deviation of a bias, but the root of the
PSD that drives it, rad/s^2/sqrt(Hz), and the process's own sigma is q sqrt(T/2). A first-order
Gauss-Markov process stands for flicker and random walk together (`lbgc.sensor.stand_in`); a T of a
thousand times the longest averaging time makes it the random walk.

What is drawn at the start fades with T. Where T is short, bias_stddev is the process's sigma, so
that its start is stationary, and the turn-on bias is lost; where T is long, or nothing drifts, it
is the turn-on bias.

`precision` (type gaussian_quantized) rounds a sample; gz-sensors takes one of 1e-6 or less as none,
and then rounding is told as white noise.
"""

from xml.sax.saxutils import escape

import numpy as np

from lbgc.exports.losses import BIAS, COUNTS, SLOW, WALK, WHITE, Scope, lines, whites
from lbgc.exports.subject import AXES, PARTS, Subject, number
from lbgc.sensor.stand_in import FAR, Figures

_LEAST_PRECISION = 1e-6
_ELEMENTS = {"gyro": "angular_velocity", "accel": "linear_acceleration"}


def gazebo(subject: Subject) -> str:
    """The content of an SDF file with one IMU sensor."""
    rounded = {part: _precision(subject, part) for part in PARTS}
    figures = {part: subject.reverting_each(part, rounded[part] == 0) for part in PARTS}
    comments = [
        *subject.title("Gazebo (gz-sensors)"),
        "put the sensor element into a link of yours; stddev belongs to this update rate",
        *(said for part in PARTS for said in _starts(subject, part, figures[part])),
        *whites(subject, [part for part in PARTS if rounded[part] == 0]),
        *(
            said
            for part in PARTS
            for said in subject.agreement(
                part, _with_rounding(subject, figures[part], rounded[part])
            )
        ),
        *lines(subject, _scope(subject, figures)),
    ]
    out = ['<?xml version="1.0"?>', *(f"<!-- {_plain(line)} -->" for line in comments)]
    out += ['<sdf version="1.10">', '  <sensor name="imu" type="imu">']
    out += [f"    <update_rate>{subject.rate_hz:.9g}</update_rate>", "    <imu>"]
    for part, element in _ELEMENTS.items():
        out.append(f"      <{element}>")
        biases = subject.triad(part).bias()
        for name, own, bias in zip("xyz", figures[part], biases, strict=True):
            start = bias if _lasts(subject, own) else own.sigma
            out += _axis(name, own, float(start), rounded[part], subject.dt)
        out.append(f"      </{element}>")
    return "\n".join([*out, "    </imu>", "  </sensor>", "</sdf>"]) + "\n"


def _axis(name: str, own: Figures, start: float, precision: float, dt: float) -> list[str]:
    """The lines of one axis's noise. start : 1 sigma of the bias at the start; precision : 0 where
    samples are not rounded."""
    rows = {
        "mean": 0.0,
        "stddev": own.N / np.sqrt(dt),
        "bias_mean": 0.0,
        "bias_stddev": start,
        "dynamic_bias_stddev": own.drive,
        "dynamic_bias_correlation_time": own.T if own.sigma else 0.0,
    }
    kind = "gaussian"
    if precision:
        rows["precision"], kind = precision, "gaussian_quantized"
    inner = [f"            <{tag}>{number(value)}</{tag}>" for tag, value in rows.items()]
    return [
        f"        <{name}>",
        f'          <noise type="{kind}">',
        *inner,
        "          </noise>",
        f"        </{name}>",
    ]


def _precision(subject: Subject, part: str) -> float:
    """What a sample is rounded to by gz-sensors, SI; 0 where it is not."""
    counts = subject.triad(part).counts
    if counts is None or counts.is_carried or counts.lsb <= _LEAST_PRECISION:
        return 0.0
    return float(counts.lsb)


def _with_rounding(subject: Subject, figures: list[Figures], precision: float) -> list[Figures]:
    """The figures with the white noise that rounding samples to a precision adds to them."""
    added = precision**2 * subject.dt / 12
    return [Figures(float(np.sqrt(own.N**2 + added)), own.K, own.sigma, own.T) for own in figures]


def _lasts(subject: Subject, own: Figures) -> bool:
    """Whether a bias that is drawn at the start stays: nothing drifts, or slowly enough."""
    far = FAR * float(subject.octaves[-1]) / 2
    return own.sigma == 0 or far <= own.T


def _starts(subject: Subject, part: str, figures: list[Figures]) -> list[str]:
    """Sentences on what bias_stddev of a triad is, and on the turn-on bias where it is lost."""
    biases = subject.triad(part).bias()
    lost = [
        f"{axis} {number(bias)}"
        for axis, own, bias in zip(AXES, figures, biases, strict=True)
        if bias > 0 and not _lasts(subject, own)
    ]
    if not lost:
        return []
    return [
        f"{part}: gz-sensors lets the bias of the start fade with the correlation time, so "
        "bias_stddev is the drifting bias's own sigma, and the turn-on bias is lost (1 sigma: "
        f"{', '.join(lost)}): draw one and give it as mean, which stays"
    ]


def _scope(subject: Subject, figures: dict[str, list[Figures]]) -> Scope:
    """What of the keys the file tells: biases of the start too, of a triad where they stay."""
    replaced = dict.fromkeys(SLOW | WALK, "the dynamic bias")
    for part in PARTS:
        if all(_lasts(subject, own) for own in figures[part]):
            by = "bias_stddev, which has all lifetimes together"
            replaced |= {f"{part}.{key}": by for key in BIAS}
    return Scope(WHITE | COUNTS, replaced)


def _plain(line: str) -> str:
    """A comment's text, in which XML allows no two hyphens."""
    return escape(line.replace("--", "- -").rstrip("-"))
