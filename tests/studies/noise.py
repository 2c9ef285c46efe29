"""Is the noise what was asked for, and does the fit say the truth about itself?

    make study-noise

Every figure of the noise terms and of the fit that this project claims, with plots.
"""

import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from importlib.util import find_spec
from multiprocessing import get_context

import allantools
import numpy as np
import scipy.stats
from common import Report, cases
from helpers import REAL_LOGS, composed
from matplotlib.figure import Figure
from tqdm import tqdm

from lbgc.data import logs
from lbgc.fit import FitConfig
from lbgc.sensor import gaussian
from lbgc.sensor.allan import octave_taus, overlapping_deviation
from lbgc.sensor.deterministic import Ramp, Sinusoid
from lbgc.sensor.fitting import noise_fit
from lbgc.sensor.fitting.likelihood import Likelihood
from lbgc.sensor.fitting.ordinates import ordinates
from lbgc.sensor.fitting.shapes import core
from lbgc.sensor.noise import (
    AngleQuantisation,
    BandLimited,
    Flicker,
    GaussMarkov,
    Line,
    RandomWalk,
    White,
)

CASES = cases("noise")
FLOOR = np.sqrt(2 * np.log(2) / np.pi)


def generator(*key: int) -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence(2026, spawn_key=key)))


def the_terms() -> dict:
    c = CASES["terms"]
    return {
        "white N": White(c["N"]),
        "flicker B": Flicker(c["B"], *CASES["flicker_corners_s"]),
        "random walk K": RandomWalk(c["K"]),
        "quantisation Q": AngleQuantisation(c["Q"]),
        "Gauss-Markov": GaussMarkov(*c["GM"]),
        "line": Line(*c["line"]),
        "filtered white": BandLimited(*c["filter"]),
        "sinusoid": Sinusoid(*c["tone"]),
    }


def block_allan(y: np.ndarray, m: int) -> np.ndarray:
    n = y.shape[-1] // m * m
    means = y[..., :n].reshape(*y.shape[:-1], -1, m).mean(axis=-1, dtype=float)
    return 0.5 * np.mean(np.diff(means, axis=-1) ** 2, axis=-1)


def requested_and_delivered(report: Report) -> None:
    """z of the mean Allan variance, and the coefficient delivered, for every term and rate."""
    report.line(f"{'term':16s} {'Hz':>4s}  worst |z|  beyond 3   delivered/requested")
    every, worst_error = [], 0.0
    figure = Figure(figsize=(12, 9), layout="constrained")
    for t, (name, term) in enumerate(the_terms().items()):
        axes = figure.add_subplot(3, 3, t + 1)
        for r, rate in enumerate(CASES["rates_hz"]):
            y = term.sample(generator(1, t, r), (CASES["draws"], CASES["samples"]), 1 / rate)
            blocks = 2 ** np.arange(int(np.log2(CASES["samples"])) - 1)
            drawn = np.stack([block_allan(y, int(m)) for m in blocks])  # (K, draws)
            expected = term.allan_variance(blocks / rate)
            spread = drawn.std(axis=1, ddof=1) / np.sqrt(drawn.shape[1])
            z = (drawn.mean(axis=1) - expected) / np.maximum(spread, 1e-9 * expected)
            weight = (expected / np.maximum(spread, 1e-9 * expected)) ** 2
            ratio = np.sqrt(np.sum(weight * drawn.mean(axis=1) / expected) / weight.sum())
            every.extend(z)
            worst_error = max(worst_error, abs(ratio - 1))
            beyond = np.mean(np.abs(z) > 3)
            report.line(
                f"{name:16s} {rate:4d}  {np.abs(z).max():9.2f}  {beyond:8.1%}   {ratio:.4f}"
            )
            axes.loglog(blocks / rate, np.sqrt(drawn.mean(axis=1)), ".", label=f"{rate} Hz")
        tau = np.geomspace(1e-3, CASES["samples"] / 40, 800)
        axes.loglog(tau, np.sqrt(term.allan_variance(tau)), "k", linewidth=0.8)
        axes.set(title=name)
        axes.legend(fontsize="x-small")
    figure.savefig(report.directory / "terms.png", dpi=120)
    ramp = Ramp(CASES["terms"]["R"])
    y = ramp.sample(generator(2), (20, 4096), 0.01)
    off = max(
        float(np.max(np.abs(block_allan(y, m) / ramp.allan_variance(m * 0.01) - 1)))
        for m in (1, 16, 256, 1024)
    )
    report.line(f"ramp: worst relative deviation {off:.1e} (float64)")
    report.summary |= {
        "worst_abs_z": float(np.abs(every).max()),
        "share_of_z_beyond_3_percent": 100 * float(np.mean(np.abs(every) > 3)),
        "z_values": len(every),
        "worst_coefficient_error_percent": 100 * worst_error,
        "ramp_worst_relative": off,
    }


def flicker(report: Report) -> None:
    """Plateau and slope of the analytic curve; a weighted regression over draws."""
    short, long = CASES["flicker_corners_s"]
    term = Flicker(1.0, short, long)
    tau = np.geomspace(short, long, 400)
    deviation = np.sqrt(term.allan_variance(tau))
    inside = (tau >= 10 * short) & (tau <= long / 10)
    slope = np.gradient(np.log(deviation), np.log(tau))[inside]
    plateau = np.abs(deviation[inside] / FLOOR - 1).max()
    y = term.sample(generator(3), (CASES["flicker_draws"], 65536), 0.1)
    blocks = 2 ** np.arange(7, 12)  # 12.8 to 205 s
    drawn = np.stack([block_allan(y, int(m)) for m in blocks])
    weight = (drawn.mean(axis=1) / drawn.std(axis=1)) ** 2
    x, v = np.log(blocks * 0.1), 0.5 * np.log(drawn.mean(axis=1))
    regressed = np.polyfit(x, v, 1, w=np.sqrt(weight))[0]
    report.line()
    report.line(
        f"flicker: slope within {np.abs(slope).max():.4f}, plateau within {plateau:.2%} of "
        f"0.664 B from 10 T_short to T_long/10; regression over {len(y)} draws "
        f"{regressed:+.4f}"
    )
    report.summary |= {
        "flicker_slope_abs_max": float(np.abs(slope).max()),
        "flicker_plateau_error_percent": 100 * float(plateau),
        "flicker_slope_regressed": float(regressed),
    }


def kasdin(seconds: float, dt: float) -> np.ndarray:
    """allantools' flicker of unit Allan deviation: rates (1, n)."""
    np.random.seed(7)  # noqa: NPY002  (the peer draws from numpy's global state)
    n = 2 ** int(np.log2(seconds / dt))
    peer = allantools.Noise(nr=n, qd=1.0, b=-3)
    peer.generateNoise()
    return np.diff(peer.time_series)[None] / peer.adev(1.0, 1.0)


def imu_error_model(seconds: float, dt: float) -> np.ndarray:
    """imu-error-model's flicker of unit level, its own definition: rates (3, n)."""
    from imu_error_model import AxisConfig, ImuConfig, ImuModel

    short, long = CASES["flicker_corners_s"]
    gyro = AxisConfig(
        flicker_bias_std=1.0,
        flicker_min_correlation_time=short,
        flicker_max_correlation_time=long,
        flicker_components=8,
    )
    model = ImuModel(ImuConfig(gyroscope=gyro), rng=generator(8))
    still, level = np.zeros(3), np.eye(3)
    n = round(seconds / dt)
    turned = [model.measure(k * dt, still, level).delta_theta for k in range(n + 1)]
    return np.array(turned[1:]).T / dt


def peers(report: Report) -> None:
    """Flicker asked for at a flat level of one, ours and the public generators', in one run."""
    case, dt = CASES["peers"], CASES["peers"]["dt_s"]
    term = Flicker(1 / FLOOR, *CASES["flicker_corners_s"])
    draws: dict[str, Callable[[], np.ndarray]] = {
        "lbgc": lambda: term.sample(generator(7), (64, round(case["seconds"] / dt)), dt),
        "allantools, Kasdin b=-3": lambda: kasdin(64 * case["seconds"], dt),
    }
    if find_spec("imu_error_model"):
        draws["imu-error-model"] = lambda: imu_error_model(case["seconds"], dt)
    else:
        report.line("imu-error-model: left out, not installed (pip install -e '.[bench]')")
    blocks = 2 ** np.arange(2, 12)
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axes = figure.add_subplot()
    report.line()
    report.line(f"{'flicker by':24s} level/asked  slope, 8 to 200 s  samples drawn a second")
    for name, draw in draws.items():
        started = time.perf_counter()
        rates = draw()
        speed = rates.size / (time.perf_counter() - started)
        drawn = np.sqrt(np.mean([block_allan(rates, int(m)) for m in blocks], axis=1))
        inside = (blocks * dt >= 8) & (blocks * dt <= 200)
        slope = np.polyfit(np.log(blocks[inside]), np.log(drawn[inside]), 1)[0]
        level = float(np.exp(np.mean(np.log(drawn[inside]))))
        report.line(f"{name:24s} {level:11.2f}  {slope:+17.3f}  {speed:22.3g}")
        axes.semilogx(blocks * dt, drawn, "o-", markersize=3, label=name)
        key = name.split(",")[0].replace("-", "_")
        report.summary |= {f"flicker_slope_{key}": float(slope), f"flicker_level_{key}": level}
    axes.axhline(1, color="0.5", linewidth=0.8)
    axes.set(xlabel="averaging time, s", ylabel="Allan deviation over what was asked", ylim=(0, 2))
    axes.legend(fontsize="small")
    figure.savefig(report.directory / "peers.png", dpi=120)


def means_law(report: Report) -> None:
    """Whitened by the predicted covariance, both ways of drawing means are chi-squared: KS of the
    p-values over many seeds."""
    terms, n, block, dt = (White(0.5), Flicker(0.7), RandomWalk(0.05)), 16, 40, 0.05
    factor = np.linalg.cholesky(gaussian.covariance_of_means(terms, n, dt, block))
    worst = 1.0
    seeds = CASES["means_law_seeds"]
    for way in ("averaged samples", "means"):
        p = []
        for seed in range(seeds):
            rng = generator(4, seed)
            if way == "means":
                y = gaussian.sample_means(terms, rng, (n,), dt, block).astype(float)
            else:
                fine = gaussian.sample(terms, rng, (n * block,), dt).astype(float)
                y = fine.reshape(n, block).mean(axis=1)
            white = np.linalg.solve(factor, y)
            p.append(scipy.stats.chi2.sf(white @ white, n))
        ks = scipy.stats.kstest(p, "uniform").pvalue
        worst = min(worst, ks)
        report.line(f"law of means, {way}: KS p = {ks:.3f} over {seeds} seeds")
    report.summary["means_law_ks_p"] = float(worst)
    seconds, rate = 64 * 240.0, 600
    costs = {}
    for way, every in (("samples", 1), ("means of 0.25 s", rate // 4)):
        started = time.perf_counter()
        shape = (64, round(240 * rate / every))
        gaussian.sample_means(terms, generator(9), shape, 1 / rate, every)
        costs[way] = (time.perf_counter() - started) / seconds
    report.line(
        "cost of a simulated second at 600 Hz, one axis: "
        + ", ".join(f"{way} {1e6 * cost:.3g} us" for way, cost in costs.items())
    )


def one_log(sensor: dict, seconds: float, key: tuple[int, ...]) -> list[dict]:
    """Fit three axes of one simulated log."""
    dt = 1 / CASES["fit"]["rate_hz"]
    terms = (White(sensor["N"]), Flicker(sensor["B"]), RandomWalk(sensor["K"]))
    y = gaussian.sample(terms, generator(*key), (3, round(seconds / dt)), dt)
    return [vars_of(noise_fit.choose(ordinates(axis, dt))) for axis in y]


def vars_of(fit: noise_fit.Fit) -> dict:
    return {name: fit.estimates[name] for name in ("N", "B", "K") if name in fit.estimates}


def fisher(sensor: dict, seconds: float) -> dict[str, float]:
    """Relative 1 sigma: the exact Gaussian likelihood of 1024 means (dense covariance, their mean
    taken out), and the spectrum's above those means' Nyquist frequency."""
    n, dt = 1024, 1 / CASES["fit"]["rate_hz"]
    interval = seconds / n
    units = {"N": White(1.0), "B": Flicker(1.0), "K": RandomWalk(1.0)}
    project = np.linalg.svd(np.eye(n) - 1 / n)[0][:, : n - 1]
    parts = {
        name: 2
        * sensor[name] ** 2
        * project.T
        @ gaussian.covariance_of_means((unit,), n, interval)
        @ project
        for name, unit in units.items()
    }
    inverse = np.linalg.inv(sum(parts.values()) / 2)
    solved = [inverse @ part for part in parts.values()]
    information = np.array([[0.5 * np.sum(a * b.T) for b in solved] for a in solved])
    data = ordinates(generator(9).standard_normal(round(seconds / dt)), dt)
    likelihood = Likelihood(data, core())
    v, J = likelihood.variance(np.log([sensor[name] for name in units]))
    above = data.f > 1 / (2 * interval)
    A = J[above] / v[above, None]
    information += 0.5 * (A * likelihood.count[above, None]).T @ A
    return dict(zip(units, np.sqrt(np.diag(np.linalg.inv(information))), strict=True))


def many_logs(sensor: dict, count: int, seconds: float, key: int) -> list[dict]:
    work = partial(one_log, sensor, seconds)
    with ProcessPoolExecutor(2, mp_context=get_context("fork")) as pool:
        jobs = pool.map(work, [(5, key, i) for i in range(count)], chunksize=4)
        return [axis for axes in tqdm(jobs, "fitting logs", count, leave=False) for axis in axes]


def fits(report: Report) -> None:
    case, seconds = CASES["fit"], CASES["fit"]["hours"] * 3600
    coverages, errors = [], []
    report.line()
    report.line(f"fit of one-hour logs at {case['rate_hz']} Hz, {case['logs']} logs x 3 axes")
    report.line("sensor               parameter  Fisher   95% interval holds  median error/Fisher")
    for s, (name, sensor) in enumerate(case["sensors"].items()):
        expected = fisher(sensor, seconds)
        found = many_logs(sensor, case["logs"], seconds, s)
        for parameter in ("N", "B", "K"):
            true = sensor[parameter]
            held = np.mean([f[parameter].low <= true <= f[parameter].high for f in found])
            median = np.median([abs(f[parameter].value / true - 1) for f in found])
            over = median / (0.6745 * expected[parameter])
            coverages.append(100 * held)
            errors.append(over)
            line = f"{name:20s} {parameter:>9s}  {expected[parameter]:6.2%}"
            report.line(f"{line}  {held:18.1%}  {over:19.3f}")
    found = many_logs(case["limited"], case["logs"], seconds, 10)
    true = case["limited"]["K"]
    held = 100 * np.mean([f["K"].upper >= true for f in found])
    limits = 100 * np.mean([f["K"].is_limit for f in found])
    report.line(
        f"SDC500 forward: K told from zero in {100 - limits:.1f}% of logs; its 95% upper limit "
        f"holds {held:.1f}%"
    )
    short = many_logs(case["limited"], case["quarter_hour_logs"], 900.0, 11)
    for parameter in ("B", "K"):
        true = case["limited"][parameter]
        limited = 100 * np.mean([f[parameter].is_limit for f in short])
        below = 100 * np.mean([f[parameter].upper >= true for f in short])
        report.line(
            f"quarter of an hour, {parameter}: an upper limit alone in {limited:.0f}%, upper "
            f"limits hold {below:.0f}%"
        )
    report.summary |= {
        "fit_coverage_min_percent": min(coverages),
        "fit_coverage_max_percent": max(coverages),
        "fit_error_over_fisher_max": max(errors),
        "upper_limit_coverage_percent": held,
    }


def adis(report: Report) -> None:
    """Fit one real unit, simulate it 100 times: is the real deviation inside their 95% band?"""
    if not (REAL_LOGS / "adis16405_imu1.parquet").exists():
        report.line("ADIS16405: left out, no recording under $LBGC_REAL_LOGS")
        return
    records = {
        u: next(logs.read(composed(FitConfig, "fit", f"log=adis16405_imu{u}").log)) for u in (1, 2)
    }
    report.line()
    for part in ("gyro", "accel"):
        inside: dict[int, list[bool]] = {1: [], 2: []}
        figure = Figure(figsize=(12, 4.2), layout="constrained")
        for axis in range(3):
            most = CASES["adis"]["samples"]
            series = {u: getattr(r, part)[:most, axis] for u, r in records.items()}
            n, dt = len(series[1]), 0.01
            fit = noise_fit.choose(ordinates(series[1], dt))
            taus = octave_taus(n, dt, most=0.1)
            real = {u: deviation(y, dt, taus) for u, y in series.items()}
            simulated = []
            for i in tqdm(range(CASES["adis"]["simulations"]), f"{part} {axis}", leave=False):
                rng = generator(6, ("gyro", "accel").index(part), axis, i)
                y = gaussian.sample(fit.terms(), rng, (n,), dt).astype(float)
                for tone in fit.tones:
                    y += Sinusoid(tone.amplitude, tone.f).sample(rng, (n,), dt)
                simulated.append(deviation(y, dt, taus))
            low, high = np.percentile(simulated, [2.5, 97.5], axis=0)
            for u, d in real.items():
                inside[u].extend((low <= d) & (d <= high))
            axes = figure.add_subplot(1, 3, axis + 1)
            axes.fill_between(taus, low, high, alpha=0.3, label="simulated, 95%")
            for u, d in real.items():
                axes.loglog(taus, d, "o-" if u == 1 else "x", markersize=3, label=f"unit {u}")
            axes.set(title=f"{part} {'xyz'[axis]}", xlabel="s")
            axes.legend(fontsize="x-small")
        figure.savefig(report.directory / f"adis16405_{part}.png", dpi=120)
        share = {u: 100 * np.mean(v) for u, v in inside.items()}
        report.line(
            f"ADIS16405 {part}: unit 1 inside its simulations' 95% band at {share[1]:.0f}% of "
            f"octave taus; unit 2 at {share[2]:.0f}%"
        )
        if part == "gyro":
            report.summary["adis16405_within_band_percent"] = share[1]
            report.summary["adis16405_other_unit_within_band_percent"] = share[2]


def deviation(y: np.ndarray, dt: float, taus: np.ndarray) -> np.ndarray:
    return overlapping_deviation(y[None, :, None], dt, taus)[0]


if __name__ == "__main__":
    with Report("studies/noise") as study:
        requested_and_delivered(study)
        flicker(study)
        peers(study)
        means_law(study)
        fits(study)
        adis(study)
