"""Does the bench move as it should, and does its vehicle sway like a real one?

    make study-motion

1. Truth against a closed form of its own, at every sample, through rest, slew and carousel.
2. What a gyro bias leaves in what turning tells.
3. Steps a second, and what share of the generation is physics.
4. The vehicle scene against the first 600 s of a real log (left out where that is absent).
"""

import time
from dataclasses import replace
from pathlib import Path

import closed_form
import numpy as np
import yaml
from common import Report
from helpers import default_config

import sim.generate
from lbgc.earth import EARTH_RATE, normal_gravity
from lbgc.frames import wrap
from lbgc.protocol import REST, SLEW, ProtocolConfig, plan
from lbgc.sensor import streams
from sim import motion, physics
from sim.poses import Bench
from sim.scene import SceneConfig, load

CASES = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text())
DEG = np.pi / 180


def drawn(scene: SceneConfig, azimuth: float, index: int = 0) -> motion.Draw:
    return motion.draw(scene, azimuth, streams.recording(1, index, streams.Purpose.MOTION), 60.0)


def protocol(values: dict) -> ProtocolConfig:
    as_tuple = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
    return ProtocolConfig(**as_tuple)


def truth_and_closed_form(report: Report) -> None:
    case = CASES["truth"]
    scene = SceneConfig(**case["bench"])
    tilts = {
        "roll": scene.base_roll_deg * DEG,
        "pitch": scene.base_pitch_deg * DEG,
        "axis_tilt": scene.axis_tilt_deg * DEG,
    }
    worst = np.zeros(3)
    report.line("worst of every sample   rate, rad/s  force, m/s2  vertical angle, rad")
    for name, values in case["motions"].items():
        duration = values.pop("duration_s")
        own = np.zeros(3)
        for latitude_deg in case["latitudes_deg"]:
            lat = latitude_deg * DEG
            gravity = normal_gravity(lat)
            bench = Bench(scene, case["rate_hz"], round(duration * case["rate_hz"]))
            planned = plan(protocol(values), 0, duration)
            found = motion.truth(bench, planned, lat, drawn(scene, 0.9))
            executed = physics.execute(bench, gravity, planned)
            last = bench.samples * bench.steps
            angle = executed.angle_at(np.arange(-1, last + 2) * bench.step)
            if executed.stretches[-1].moves:
                angle[-1] = executed.stretches[-1].poses.angle[-1]
            omega, force = closed_form.sample_means(
                angle, bench.step, bench.steps, latitude=lat, gravity=gravity, azimuth=0.9,
                arm=scene.arm_m, **tilts
            )  # fmt: skip
            level = replace(scene, base_roll_deg=0.0, base_pitch_deg=0.0, axis_tilt_deg=0.0)
            flat = motion.truth(replace(bench, scene=level), planned, lat, drawn(level, 0.9))
            earth = -EARTH_RATE * np.sin(lat)
            vertical = (flat.omega_ib_b[2] - earth) / bench.rate_hz
            turned = np.diff(flat.plate_angle, prepend=0.0)
            errors = (found.omega_ib_b.T - omega, found.f_ib_b.T - force, vertical - turned)
            own = np.maximum(own, [np.abs(e).max() for e in errors])
        worst = np.maximum(worst, own)
        report.line(f"{name:24s}{own[0]:11.1e}  {own[1]:11.1e}  {own[2]:19.1e}")
    report.summary |= {
        "rate_error_max_rad_per_s": worst[0],
        "force_error_max_m_per_s2": worst[1],
        "angle_error_max_rad": worst[2],
    }


def bias_leak(report: Report) -> None:
    """Heading from the cosine and sine of the plate's angle in both horizontal rates, by least
    squares with a constant: with and without a bias, no noise."""
    bias = CASES["bias_deg_per_h"] * DEG / 3600
    report.line()
    report.line(f"heading moved by a bias of {CASES['bias_deg_per_h']} deg/h, deg")
    leaks = []
    for name, values in CASES["turning"].items():
        scene, rate = SceneConfig(), 100.0
        bench = Bench(scene, rate, round(values["duration_s"] * rate))
        values = {k: v for k, v in values.items() if k != "duration_s"}
        planned = plan(protocol(values), 0, bench.samples / rate)
        found = motion.truth(bench, planned, 0.5718, drawn(scene, 0.4))
        middle = found.plate_angle - np.diff(found.plate_angle, prepend=0.0) / 2
        used = found.stage == (REST if values["kind"] == "indexed" else SLEW)
        design = np.stack([np.cos(middle), np.sin(middle), np.ones(len(middle))], axis=1)[used]
        headings = []
        for added in (0.0, bias):
            x, y = (found.omega_ib_b[axis][used] + added for axis in (0, 1))
            (a, b, _), (c, d, _) = (np.linalg.lstsq(design, v, rcond=None)[0] for v in (x, y))
            headings.append(np.arctan2(-b - c, a - d))
        leaks.append(abs(float(np.rad2deg(wrap(headings[1] - headings[0])))))
        report.line(f"{name:24s}{leaks[-1]:.1e}")
    report.summary["bias_leak_max_deg"] = max(leaks)


def speed(report: Report) -> None:
    """Rollout's own steps a second, and generation with and without what is not physics."""
    report.line()
    report.line("case                   physics, s   whole, s   physics' share   (a recording)")
    for name, options in CASES["speed"].items():
        config = default_config(*options)
        imu = config.imu
        sensor = sim.generate._Sensor(
            imu.gyro.triad(), imu.accel.triad(), imu.timing.timing(), config
        )
        rows = range(CASES["speed_recordings"])
        latitude = config.latitude * DEG
        plans = [plan(config.protocol, i, config.duration_s) for i in rows]

        def truths(config=config, plans=plans, latitude=latitude, rows=rows) -> None:
            draws = [
                motion.draw(
                    config.scene, 0.1, streams.recording(1, i, streams.Purpose.MOTION),
                    config.duration_s,
                )
                for i in rows
            ]  # fmt: skip
            list(motion.truths(config.bench, plans, latitude, draws, threads=2))

        def whole(config=config, sensor=sensor, rows=rows) -> None:
            list(sim.generate._recordings(config, sensor, rows))

        pairs = []
        for _ in range(CASES["speed_repeats"]):
            times = []
            for work in (truths, whole):
                physics.execute.cache_clear()
                physics._settling.cache_clear()
                started = time.perf_counter()
                work()
                times.append((time.perf_counter() - started) / len(rows))
            pairs.append(times)
        moved, made = np.median(pairs, axis=0)
        share = float(np.median([a / b for a, b in pairs]))
        report.line(f"{name:22s}{moved:11.4f}{made:11.4f}{share:14.0%}")
        report.summary[f"physics_share_{name}_percent"] = 100 * share
    for name, scene in (
        ("rigid", SceneConfig()),
        ("vehicle", default_config("scene=vehicle").scene),
    ):
        model = load(scene, 9.8)
        control = np.zeros((2, 60_000, model.nu))
        states = [physics._state(model, 0.0)] * 2
        rates = []
        for _ in range(3):
            started = time.perf_counter()
            physics.roll([model] * 2, states, control, threads=2)
            rates.append(control.shape[0] * control.shape[1] / (time.perf_counter() - started))
        report.line(f"steps a second, {name}, two threads: {np.median(rates):,.0f}")
        key = "physics_steps_per_s" if name == "rigid" else f"physics_steps_per_s_{name}"
        report.summary[key] = float(np.median(rates))


if __name__ == "__main__":
    with Report("studies/motion") as study:
        truth_and_closed_form(study)
        bias_leak(study)
        speed(study)
