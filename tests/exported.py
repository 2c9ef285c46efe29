"""Other tools' models of an IMU, read from the files that are written for them and simulated as
their own documentation says: the other side of every comparison, without lbgc's laws.

Each tool's samples are white noise, a walk, and an autoregression; the sources are named at each
reader. A file tells either one model for a triad or one an axis.
"""

import ast
import json
import re
from dataclasses import dataclass
from functools import lru_cache
from xml.etree import ElementTree

import numpy as np
import yaml
from scipy.signal import lfilter

PARTS = ("gyro", "accel")
AXES = ("forward", "right", "down")


@dataclass(frozen=True)
class Model:
    """What a tool makes of one axis: all 1 sigma, SI."""

    white: float
    """Of one sample."""
    pole: float = 1.0
    """Factor of the drift from one sample to the next."""
    kick: float = 0.0
    """What the drift gets a sample."""
    start: float = 0.0
    """Of the drift before the first sample."""
    walk: float = 0.0
    """What a walk beside gets a sample."""
    resolution: float = 0.0
    """What samples are rounded to."""

    def simulate(self, rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
        """Independent series (R, n) of samples."""
        first = self.start * rng.standard_normal((shape[0], 1))
        kicks = self.kick * rng.standard_normal(shape)
        state = self.pole * first
        drift, _ = lfilter([1.0], [1.0, -self.pole], kicks, axis=1, zi=state)
        drift += np.cumsum(self.walk * rng.standard_normal(shape), axis=1)
        samples = drift + self.white * rng.standard_normal(shape)
        if self.resolution:
            samples = np.round(samples / self.resolution) * self.resolution
        return samples

    def allan_variance(self, m: int) -> float:
        """Of means over m samples, once the drift has its law: by what each kick adds."""
        inside, before = _weights(self.pole, m)
        steady = 0.0 if self.pole == 1 else self.kick**2 / (1 - self.pole**2)
        drift = (self.kick**2 * inside + steady * before) / 2
        walk = self.walk**2 * _weights(1.0, m)[0] / 2
        return float((self.white**2 + self.resolution**2 / 12) / m + drift + walk)


@lru_cache(maxsize=4096)
def _weights(pole: float, m: int) -> tuple[float, float]:
    """Of the difference of two neighbouring means over m values of x[k] = pole x[k-1] + kick: the
    sum of the squared weights of the kicks after the first value, and that of the first value."""
    mean = np.repeat([1 / m, -1 / m], m)  # from the last value to the first
    weights = lfilter([1.0], [1.0, -pole], mean)
    return float(np.sum(weights[:-1] ** 2)), 0.0 if pole == 1 else float(weights[-1] ** 2)


def _continuous(density: float, walk: float, dt: float) -> Model:
    """Kalibr's wiki, IMU Noise Model: sigma/sqrt(dt) a sample, and sigma_b sqrt(dt) a step."""
    return Model(density / np.sqrt(dt), kick=walk * np.sqrt(dt))


def kalibr(text: str, dt: float) -> dict[str, list[Model]]:
    return _four(yaml.safe_load(text), dt)


def openvins(text: str, dt: float) -> dict[str, list[Model]]:
    """Propagator.cpp: Qc has sigma_w^2/dt and sigma_wb^2 dt. The first line is OpenCV's own."""
    first, rest = text.split("\n", 1)
    assert first == "%YAML:1.0"
    (group,) = yaml.safe_load(rest).values()
    return _four(group, dt)


def _four(keys: dict, dt: float) -> dict[str, list[Model]]:
    assert keys["update_rate"] == 1 / dt
    names = {"gyro": "gyroscope", "accel": "accelerometer"}
    return {
        part: [_continuous(keys[f"{n}_noise_density"], keys[f"{n}_random_walk"], dt)]
        for part, n in names.items()
    }


def gtsam(text: str, dt: float) -> dict[str, list[Model]]:
    """CombinedImuFactor.cpp: wCov/dt, aCov/dt, dt biasOmegaCovariance, dt biasAccCovariance."""
    fields = {name: np.array(rows) for name, rows in yaml.safe_load(text).items()}
    for matrix in fields.values():
        np.testing.assert_array_equal(matrix, np.diag(np.diag(matrix)))
    names = {
        "gyro": ("gyroscopeCovariance", "biasOmegaCovariance"),
        "accel": ("accelerometerCovariance", "biasAccCovariance"),
    }
    return {
        part: [
            Model(np.sqrt(white / dt), kick=np.sqrt(dt * walk))
            for white, walk in zip(np.diag(fields[one]), np.diag(fields[two]), strict=True)
        ]
        for part, (one, two) in names.items()
    }


def ros(text: str, dt: float) -> dict[str, list[Model]]:
    """Imu.msg: variances of a measurement on the diagonal of nine, row major."""
    keys = yaml.safe_load(text)
    assert keys["orientation_covariance"][0] == -1
    names = {"gyro": "angular_velocity_covariance", "accel": "linear_acceleration_covariance"}
    return {
        part: [Model(np.sqrt(v)) for v in np.diag(np.reshape(keys[name], (3, 3)))]
        for part, name in names.items()
    }


def gazebo(text: str, dt: float) -> dict[str, list[Model]]:
    """GaussianNoiseModel.cc: Load and ApplyImpl."""
    sensor = ElementTree.fromstring(text).find("sensor")
    assert float(sensor.findtext("update_rate")) == 1 / dt
    names = {"gyro": "angular_velocity", "accel": "linear_acceleration"}
    return {
        part: [_gazebo(sensor.find(f"imu/{name}/{axis}/noise"), dt) for axis in "xyz"]
        for part, name in names.items()
    }


def _gazebo(noise: ElementTree.Element, dt: float) -> Model:
    value = {child.tag: float(child.text) for child in noise}
    quantised = noise.get("type") == "gaussian_quantized"
    precision = value.get("precision", 0.0) if quantised else 0.0
    assert value["mean"] == value["bias_mean"] == 0
    q, T = value["dynamic_bias_stddev"], value["dynamic_bias_correlation_time"]
    drifts = q > 0 and T > 0
    return Model(
        value["stddev"],
        pole=np.exp(-dt / T) if drifts else 1.0,
        kick=np.sqrt(-(q**2) * T / 2 * np.expm1(-2 * dt / T)) if drifts else 0.0,
        start=value["bias_stddev"],
        resolution=precision if precision > 1e-6 else 0.0,
    )


PX4_STEP, ARDUPILOT_STEP = 0.01, 0.012


def px4(text: str, dt: float) -> dict[str, list[Model]]:
    """covariance.cpp, with steps of 10 ms: an angle's variance grows by (step noise)^2 a step, a
    bias's by (step b_noise)^2."""
    rows = [line.split("\t") for line in text.splitlines() if line[0] != "#"]
    assert {(vehicle, part, kind) for vehicle, part, _, _, kind in rows} == {("1", "1", "9")}
    value = {name: float(v) for _, _, name, v, _ in rows}
    names = {"gyro": ("EKF2_GYR_NOISE", "EKF2_GYR_B_NOISE"),
             "accel": ("EKF2_ACC_NOISE", "EKF2_ACC_B_NOISE")}  # fmt: skip
    return _filter(value, names, PX4_STEP, dt)


def ardupilot(text: str, dt: float) -> dict[str, list[Model]]:
    """AP_NavEKF3_core.cpp, with steps of 12 ms: (dt noise)^2 of an angle; (dt^2 b_noise)^2 of the
    bias's angle over a step."""
    rows = [line.split(",") for line in text.splitlines() if line[0] != "#"]
    names = {"gyro": ("EK3_GYRO_P_NSE", "EK3_GBIAS_P_NSE"),
             "accel": ("EK3_ACC_P_NSE", "EK3_ABIAS_P_NSE")}  # fmt: skip
    return _filter({name: float(v) for name, v in rows}, names, ARDUPILOT_STEP, dt)


def _filter(value: dict, names: dict, step: float, dt: float) -> dict[str, list[Model]]:
    """Of noise that grows an angle and a bias by so much a step, samples at dt."""
    models = {}
    for part, (noise, b_noise) in names.items():
        angle, bias = (step * value[noise]) ** 2 / step, (step * value[b_noise]) ** 2 / step
        models[part] = [Model(np.sqrt(angle / dt), kick=np.sqrt(bias * dt))]
    return models


def matlab(text: str, dt: float) -> dict[str, list[Model]]:
    """imuSensor, Algorithms, with the default NoiseType, "double-sided"; loadparams, and then the
    lines under `use`."""
    (own,) = json.loads(text).values()
    names = {"gyro": "Gyroscope", "accel": "Accelerometer"}
    bandwidth = 1 / dt / 2
    models = {}
    for part, name in names.items():
        value, filtered = own[name], own["BiasInstabilityCoefficients"][part]
        one, minus_pole = filtered["Denominator"]
        assert (one, filtered["Numerator"], value["ConstantBias"]) == (1, 1, [0, 0, 0])
        models[part] = [
            Model(
                np.sqrt(bandwidth) * value["NoiseDensity"][i],
                pole=-minus_pole,
                kick=value["BiasInstability"][i],
                walk=value["RandomWalk"][i] / np.sqrt(bandwidth),
                resolution=value["Resolution"],
            )
            for i in range(3)
        ]
    return models


def gnss_ins_sim(text: str, dt: float) -> dict[str, list[Model]]:
    """pathgen.py: gyro_gen, acc_gen and bias_drift."""
    plain = re.sub(r"np\.array\((\[.*?\])\)", r"\1", text)
    found = {
        node.targets[0].id: ast.literal_eval(node.value)
        for node in ast.parse(plain).body
        if isinstance(node, ast.Assign)
    }
    names = {"gyro": ("gyro_err", "arw"), "accel": ("accel_err", "vrw")}
    models = {}
    for part, (name, white) in names.items():
        value = found[name]
        assert value["b"] == [0, 0, 0]
        assert np.isfinite(value["b_corr"]).all()
        models[part] = [
            Model(w / np.sqrt(dt), pole=1 - dt / T, kick=d * np.sqrt(-np.expm1(-2 * dt / T)))
            for w, d, T in zip(value[white], value["b_drift"], value["b_corr"], strict=True)
        ]
    return models


READERS = {
    "kalibr": kalibr,
    "openvins": openvins,
    "gtsam": gtsam,
    "ros": ros,
    "gazebo": gazebo,
    "px4": px4,
    "ardupilot": ardupilot,
    "matlab": matlab,
    "gnss_ins_sim": gnss_ins_sim,
}

_CLAIM = re.compile(
    r"(gyro|accel)(?: (forward|right|down))?: Allan deviation within 5% of the sensor's at "
    r"(?:all octaves of (?P<all>.*?)|octaves of (?P<some>.*?) and at no other of .*?|"
    r"(?P<none>no octave) of .*?)(?:;.*?)?(?: -->|\",?)?$",
    re.MULTILINE,
)


def claims(text: str, tau: np.ndarray) -> dict[tuple[str, str], np.ndarray]:
    """Of each triad and axis, at which of the averaging times tau (L,) the file says that its Allan
    deviation is the sensor's, bool (L,)."""
    found = {}
    for match in _CLAIM.finditer(text):
        said = match["all"] or match["some"] or ""
        held = np.zeros(len(tau), bool)
        for run in filter(None, said.split(" and ")):
            ends = [float(value) for value in run.removesuffix(" s").split(" to ")]
            held |= (tau > 0.999 * ends[0]) & (tau < 1.001 * ends[-1])
        for axis in [match[2]] if match[2] else AXES:
            found[match[1], axis] = held
    return found


def of_axes(models: list[Model]) -> list[Model]:
    """One model an axis, where a file has one for all."""
    return models * 3 if len(models) == 1 else models
