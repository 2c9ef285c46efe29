"""A sensor as MATLAB's imuSensor simulates it: a JSON file for `loadparams`.

With the default NoiseType "double-sided" imuSensor takes a noise bandwidth of half the rate: a
sample has white noise of NoiseDensity sqrt(rate/2), and the bias walks by RandomWalk/sqrt(rate/2) a
sample (its documentation, "Algorithms"; gyroparams, accelparams). So NoiseDensity is the one-sided
density, sqrt(2) N, as data sheets print it, and RandomWalk is K/sqrt(2). Either would be off by
sqrt(2) if N and K were given as they are.

BiasInstability is the standard deviation of a sample of white noise, which the filter
BiasInstabilityCoefficients then shapes. The default, fractalcoef, has one pole at 1/2: it forgets
within two samples, and makes no flat floor of the Allan deviation. So a pole at e^(-dt/T) is given,
which makes a first-order Gauss-Markov process of sigma, with BiasInstability = sigma sqrt(1 -
e^(-2 dt/T)), in the place of flicker; one T for a triad's three axes (`lbgc.sensor.stand_in`). More
poles would follow flicker further, but so near to 1 they lose their places in the rounding of the
filter's coefficients, in single precision first; and fractalcoef would take rate x T of them. The
filter begins at zero, so that the process has its law after some T. Both drifts begin at zero.

`loadparams` takes only numbers and "inf", and passes over what is in a part beside Accelerometer
and Gyroscope (R2020a and later): the coefficients (R2023b) are set by the line under `use`. Without
it a drift of negligible size is made, and no bias instability.
"""

from dataclasses import replace

import numpy as np

from lbgc.exports.losses import COUNTS, RANGE, SLOW, WALK, WHITE, Scope, lines
from lbgc.exports.subject import PARTS, Subject
from lbgc.outputs import as_json
from lbgc.sensor import stand_in
from lbgc.sensor.stand_in import Figures

_SCOPE = Scope(WHITE | WALK | COUNTS | RANGE, dict.fromkeys(SLOW, "BiasInstability behind a pole"))
_NAMES = {"accel": "Accelerometer", "gyro": "Gyroscope"}
FILE = "imuSensor.json"


def matlab(subject: Subject) -> str:
    """The content of the JSON file: one part, `lbgc`."""
    figures = {part: _figures(subject, part) for part in PARTS}
    poles = {part: float(np.exp(-subject.dt / own[0].T)) for part, own in figures.items()}
    part = {
        **{name: _parameters(subject, part, figures[part]) for part, name in _NAMES.items()},
        "BiasInstabilityCoefficients": {
            part: {"Numerator": 1, "Denominator": [1, -pole]} for part, pole in poles.items()
        },
        "use": _use(subject),
        "holds": [
            *subject.title("MATLAB's imuSensor"),
            *(
                said
                for part in PARTS
                for said in subject.agreement(part, _with_rounding(subject, part, figures[part]))
            ),
            "both drifts begin at zero: the law holds after some correlation times",
        ],
        "lost": lines(subject, _SCOPE),
    }
    return as_json({"lbgc": part}) + "\n"


def _figures(subject: Subject, part: str) -> list[Figures]:
    """White noise, random walk and one process of each axis, of one correlation time."""
    return stand_in.reverting(subject.slow(part, rounding=False), subject.fine, walk=True)


def _parameters(subject: Subject, part: str, figures: list[Figures]) -> dict[str, object]:
    """The properties of accelparams or gyroparams."""
    triad = subject.triad(part)
    rounded = triad.counts is not None and not triad.counts.is_carried
    return {
        "MeasurementRange": "inf" if triad.range is None else triad.range,
        "Resolution": triad.counts.lsb if rounded and triad.counts is not None else 0.0,
        "ConstantBias": [0.0, 0.0, 0.0],
        "NoiseDensity": [float(np.sqrt(2) * own.N) for own in figures],
        "BiasInstability": [
            float(own.sigma * np.sqrt(-np.expm1(-2 * subject.dt / own.T))) for own in figures
        ],
        "RandomWalk": [float(own.K / np.sqrt(2)) for own in figures],
    }


def _with_rounding(subject: Subject, part: str, figures: list[Figures]) -> list[Figures]:
    """The figures with the white noise that Resolution adds to samples."""
    with_it, without = (subject.slow(part, rounding) for rounding in (True, False))
    counts = subject.triad(part).counts
    if counts is None or counts.is_carried:
        return figures
    added = [a.N**2 - b.N**2 for a, b in zip(with_it, without, strict=True)]
    return [
        replace(own, N=float(np.sqrt(own.N**2 + more)))
        for own, more in zip(figures, added, strict=True)
    ]


def _use(subject: Subject) -> list[str]:
    """The lines of MATLAB that load the file."""
    coefficients = "p.lbgc.BiasInstabilityCoefficients"
    shaped = [
        f"s.{name}.BiasInstabilityCoefficients = struct('Numerator', 1, 'Denominator', "
        f"{coefficients}.{part}.Denominator(:)');"
        for part, name in _NAMES.items()
    ]
    return [
        f"s = imuSensor('accel-gyro', 'SampleRate', {subject.rate_hz:.9g});",
        f"loadparams(s, '{FILE}', 'lbgc');",
        f"p = jsondecode(fileread('{FILE}'));",
        *shaped,
    ]
