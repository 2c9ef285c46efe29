"""Does the bench move as it should, and does its vehicle sway like a real one?

    make study-motion

1. Truth against a closed form of its own, at every sample, through rest, slew and carousel.
2. What a gyro bias leaves in what turning tells.
3. Steps a second, and what share of the generation is physics.
4. The vehicle scene against the first 600 s of a real log (left out where that is absent).
"""

import time
from dataclasses import replace
from functools import partial

import closed_form
import numpy as np
from common import Report, cases
from helpers import REAL_LOGS, composed, default_config
from matplotlib.figure import Figure
from tqdm import tqdm
from vehicle_likeness import BANDS_HZ, FIGURES, WINDOWS_S, band_psd, likeness

import sim.generate
import sim.recordings
from lbgc.data import logs
from lbgc.data.record import Record
from lbgc.earth import EARTH_RATE, normal_gravity
from lbgc.evaluate import EvaluateConfig
from lbgc.frames import wrap
from lbgc.protocol import REST, SLEW, ProtocolConfig, plan
from lbgc.report.figures import AXIS_NAMES
from lbgc.sensor import streams
from sim import motion, physics
from sim.poses import Bench
from sim.turntable import SceneConfig, load

CASES = cases("motion")
DEG = np.pi / 180


def drawn(scene: SceneConfig, azimuth: float, index: int = 0) -> motion.Draw:
    stream = partial(streams.recording, 1, index, streams.Purpose.MOTION)
    return motion.draw(scene, azimuth, stream, 60.0)


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
    """The heading that turning tells, with and without a bias, no noise."""
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
        headings = [
            closed_form.heading_from_turning(middle[used], *(found.omega_ib_b[:2, used] + added))
            for added in (0.0, bias)
        ]
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
        sensor = sim.recordings.Sensor(
            imu.gyro.triad(), imu.accel.triad(), imu.timing.timing(), config
        )
        rows = range(CASES["speed_recordings"])
        latitude = config.latitude * DEG
        plans = [plan(config.protocol, i, config.duration_s) for i in rows]

        def truths(config=config, plans=plans, latitude=latitude, rows=rows) -> None:
            draws = [
                motion.draw(
                    config.scene, 0.1,
                    partial(streams.recording, 1, i, streams.Purpose.MOTION), config.duration_s,
                )
                for i in rows
            ]  # fmt: skip
            list(motion.truths(config.bench, plans, latitude, draws, threads=2))

        def whole(config=config, sensor=sensor, rows=rows) -> None:
            list(sim.recordings.recordings(config, sensor, rows))

        pairs = []
        for _ in range(CASES["speed_repeats"]):
            times = []
            for work in (truths, whole):
                physics.execute.cache_clear()
                physics.execute_resting.cache_clear()
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
        control = np.zeros((2, CASES["speed_steps"], model.nu))
        states = [physics._state(model, 0.0)] * 2
        rates = []
        for _ in range(3):
            started = time.perf_counter()
            physics.roll([model] * 2, states, control, physics.data_for(model, 2))
            rates.append(control.shape[0] * control.shape[1] / (time.perf_counter() - started))
        report.line(f"steps a second, {name}, two threads: {np.median(rates):,.0f}")
        key = "physics_steps_per_s" if name == "rigid" else f"physics_steps_per_s_{name}"
        report.summary[key] = float(np.median(rates))


def vehicle(report: Report) -> None:
    """The vehicle scene's logs against the real one's first 600 s, counts and noise included."""
    case = CASES["vehicle"]
    if not (REAL_LOGS / "lasergyro.imu").exists():
        report.line("vehicle: left out, no lasergyro.imu under $LBGC_REAL_LOGS")
        return
    log = composed(EvaluateConfig, "evaluate", "log=lasergyro").log
    whole = next(logs.read(log))
    n = round(case["seconds"] * whole.rate_hz)
    real = replace(
        whole, gyro=whole.gyro[:n], accel=whole.accel[:n], plate_angle=whole.plate_angle[:n]
    )
    count = case["logs"]
    config = default_config(
        *case["options"], f"recordings={count}", f"latitude={np.rad2deg(whole.latitude)}"
    )
    imu = config.imu
    sensor = sim.recordings.Sensor(imu.gyro.triad(), imu.accel.triad(), imu.timing.timing(), config)
    scales = (t.output_scale(1 / config.rate_hz) or 1.0 for t in (sensor.gyro, sensor.accel))
    gyro_scale, accel_scale = scales
    simulated, headings = [], []
    rows = sim.recordings.recordings(config, sensor, range(count))
    for i, row in enumerate(tqdm(rows, "swaying", count, leave=False)):
        simulated.append(
            replace(
                real,
                name=f"simulated {i}",
                gyro=row["gyro"] * gyro_scale,
                accel=row["accel"] * accel_scale,
                heading=float(row["heading"]),
            )
        )
        headings.append(float(row["heading"] + row["attitude"][:, 2].mean(dtype=float)))
    assert whole.heading_reference is not None
    like = likeness(real, whole.heading_reference, simulated, headings)
    report.line()
    report.line(
        f"vehicle: {count} simulated logs of {case['seconds']} s against the real one's first"
    )
    report.line(
        f"third-octave PSD within a factor of 2 in {like.within_2_percent:.1f}% of "
        f"{like.psd_ratio.size} bands, of {like.worst_ratio:.2f} in all"
    )
    spread = " ".join(f"{r:.2f}" for r in like.spread_ratio)
    report.line(f"spread of 60 s band power over the real one's, gyro and accelerometer: {spread}")
    wide = like.high / like.low
    for i, window in enumerate(WINDOWS_S):
        figures = ", ".join(
            f"{name} {like.real[i, j]:.1f} [{like.low[i, j]:.1f}, {like.high[i, j]:.1f}] "
            f"x{wide[i, j]:.2f}"
            for j, name in enumerate(FIGURES)
        )
        report.line(f"plain mean, {window:g} s: {figures}")
    narrow = like.inside & (wide <= 3)
    report.line(
        f"inside the simulated 95% range: {like.inside.sum()} of {like.inside.size}, of which "
        f"{narrow.sum()} with a range at most a factor of 3 wide"
    )
    report.summary |= {
        "vehicle_psd_bands_within_2_percent": like.within_2_percent,
        "vehicle_psd_ratio_max": like.worst_ratio,
        "vehicle_spell_ratio": float(np.exp(np.abs(np.log(like.spread_ratio)).max())),
        "vehicle_baseline_figures_inside_percent": float(100 * like.inside.mean()),
        "vehicle_baseline_figures_inside_and_narrow_percent": float(100 * narrow.mean()),
        "vehicle_baseline_range_widest": float(wide.max()),
    }
    picture(report, real, simulated)


def picture(report: Report, real: Record, simulated: list[Record]) -> None:
    """Spectra of all logs, and how the angles go in the real one and in four of the others."""
    figure = Figure(figsize=(14, 9), layout="constrained")
    axes = figure.subplots(3, 3)
    middle = np.sqrt(BANDS_HZ[1:] * BANDS_HZ[:-1])
    every = np.stack([band_psd(r) for r in simulated])
    own = band_psd(real)
    names = [f"{part} {axis}" for part in ("gyro", "accel") for axis in AXIS_NAMES]
    for i, name in enumerate(names):
        ax = axes[i // 3, i % 3]
        ax.fill_between(middle, *np.percentile(every[:, :, i], [5, 95], axis=0), alpha=0.3)
        ax.loglog(middle, every[:, :, i].mean(axis=0), label="simulated")
        ax.loglog(middle, own[:, i], "k", label="real")
        ax.set(title=name, xlabel="Hz")
        ax.legend(fontsize="x-small")
    for axis in range(3):
        ax = axes[2, axis]
        for place, record in enumerate([real, *simulated[:4]]):
            rate = record.gyro[:, axis] - record.gyro[:, axis].mean()
            angle = np.rad2deg(np.cumsum(rate) / record.rate_hz) * 3600
            t = np.arange(len(angle)) / record.rate_hz
            ax.plot(t, angle - 3000 * place, "k" if place == 0 else "C0", linewidth=0.7)
        ax.set(title=f"angle {AXIS_NAMES[axis]}, arcsec; black: real", xlabel="s")
    figure.savefig(report.directory / "vehicle.png", dpi=90)


if __name__ == "__main__":
    with Report("studies/motion") as study:
        truth_and_closed_form(study)
        bias_leak(study)
        speed(study)
        vehicle(study)
