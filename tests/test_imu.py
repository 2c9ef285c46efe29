"""The error model: what each figure does, for how long it stays, and that none is a lie."""

from dataclasses import fields, replace

import numpy as np
import pytest
from helpers import figures

from lbgc.errors import InputError
from lbgc.sensor import noise, streams
from lbgc.sensor.datasheet import AccelConfig, AccelLine, GyroConfig, GyroLine
from lbgc.sensor.deterministic import Sinusoid
from lbgc.sensor.dither import check_means
from lbgc.sensor.errors import Surroundings
from lbgc.sensor.imu import Triad
from lbgc.sensor.noise import Flicker, RandomWalk
from lbgc.units import DEG, HOUR

GYRO = GyroConfig(
    arw_deg_per_sqrt_h=0.3,
    bias_instability_deg_per_h=2.0,
    rrw_deg_per_h_per_sqrt_h=30.0,
    bias_unit_deg_per_h=1.0,
    bias_session_deg_per_h=0.5,
    bias_run_deg_per_h=0.2,
    scale_unit_ppm=3000.0,
    misalignment_unit_mrad=5.0,
    quantisation_arcsec=0.01,
    ramp_deg_per_h_per_h=500.0,
    gauss_markov_deg_per_h=3.0,
    gauss_markov_s=5.0,
    lines=(GyroLine(20.0, 7.0, 0.5),),
    bandwidth_hz=20.0,
    g_sensitivity_deg_per_h_per_g=2.0,
    bias_per_k_deg_per_h_per_k=0.1,
    scale_per_k_ppm_per_k=1000.0,
    tone_hz=3.1,
    tone_deg_per_h=[50.0, 20.0, 0.0],
    rate_lsb_deg_per_s=1e-4,
    range_deg_per_s=1.0,
)
ACCEL = AccelConfig(
    noise_ug_per_sqrt_hz=100.0,
    bias_instability_ug=50.0,
    random_walk_ug_per_sqrt_h=500.0,
    bias_unit_mg=1.0,
    bias_session_mg=0.5,
    bias_run_mg=0.2,
    scale_unit_ppm=3000.0,
    misalignment_unit_mrad=5.0,
    quantisation_ug_s=1.0,
    ramp_ug_per_h=2e4,
    gauss_markov_ug=30.0,
    gauss_markov_s=5.0,
    lines=(AccelLine(100.0, [7.0, 8.0, 9.0], 0.5),),
    bandwidth_hz=20.0,
    bias_per_k_ug_per_k=30.0,
    scale_per_k_ppm_per_k=30.0,
    tone_hz=3.1,
    tone_ug=[50.0, 20.0, 0.0],
    lsb_ug=10.0,
    range_g=1.001,
)
CHANGED = {
    "flicker_short_s": 3.0,
    "flicker_long_s": 500.0,
    "range_deg_per_s": 0.001,
    "range_g": 0.5,
    "tone_hz": 2.7,
}


def prints(config: GyroConfig | AccelConfig, n: int = 3000, dt: float = 0.01) -> np.ndarray:
    """What a sensor of this configuration prints, in SI, everything drawn as in a dataset."""
    triad = config.triad()
    truth = np.array([[4e-5], [-5e-5], [3e-5]])
    if isinstance(config, AccelConfig):
        truth = np.array([[0.1], [-0.2], [-9.8]])
    errors = triad.draw_run(
        streams.recording(5, 0, streams.Purpose.GYRO),
        triad.draw_unit(streams.unit(5, 0)) | triad.draw_session(streams.session(5, 0, 0)),
    )
    rng = streams.recording(5, 1, streams.Purpose.GYRO)
    force = None if isinstance(config, AccelConfig) else np.array([[0.1], [-0.2], [-9.8]])
    warming = Surroundings(force, rise_k=20.0, time_s=30.0)
    return triad.measure(rng, truth, errors, n, dt, warming)[0] * (triad.output_scale(dt) or 1.0)


@pytest.mark.parametrize("config", [GYRO, ACCEL], ids=["gyro", "accel"])
def test_every_figure_changes_what_the_sensor_prints(config):
    usual = prints(config)
    for field in fields(config):
        value = getattr(config, field.name)
        if value is None:  # the other unit of the noise: tested below
            continue
        scaled = [2 * v for v in value] if isinstance(value, list) else 2 * value
        changed = replace(config, **{field.name: CHANGED.get(field.name, scaled)})
        assert not np.array_equal(prints(changed), usual), field.name


@pytest.mark.parametrize("config", [GyroConfig(), AccelConfig()])
def test_a_sensor_without_errors_prints_the_truth(config):
    truth = np.array([[4e-5], [-5e-5], [3e-5]])
    if isinstance(config, AccelConfig):
        truth = np.array([[0.1], [-0.2], [-9.8]])
    np.testing.assert_allclose(prints(config), np.broadcast_to(truth, (3, 3000)), rtol=1e-6)


@pytest.mark.parametrize("config_class", [GyroConfig, AccelConfig])
def test_negative_figures_are_refused_by_name(config_class):
    for field in fields(config_class):
        with pytest.raises(InputError, match=field.name):
            config_class(**{field.name: -1.0})


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"arw_deg_per_sqrt_h": [1.0, 2.0]}, "one number or three"),
        ({"rate_lsb_deg_per_s": 0.0}, "greater than zero"),
        ({"flicker_long_s": 0.5}, "above flicker_short_s = 1.0"),
        ({"tone_deg_per_h": 3.0}, "must be given for tone_deg_per_h = 3.0"),
        ({"bandwidth_hz": [5.0, 0.0, 5.0]}, "must be greater than zero"),
    ],
)
def test_figures_that_make_no_sense_are_refused(values, says):
    with pytest.raises(InputError, match=says):
        GyroConfig(**values)


def test_lines_are_as_many_as_are_given():
    two = GyroConfig(
        lines=(GyroLine(20.0, 7.0, 0.5), GyroLine([0.0, 3.0, 0.0], [0.0, 19.0, 0.0], 2.0))
    )
    terms = two.triad().terms
    assert terms[0] == (noise.Line(20.0 * DEG / HOUR, 7.0, 0.5),)
    assert terms[1] == (*terms[0], noise.Line(3.0 * DEG / HOUR, 19.0, 2.0))
    with pytest.raises(InputError, match=r"width_hz = 0.0 Hz: must be above zero where deg_per_h"):
        GyroLine([0.0, 1.0, 0.0], 3.0, 0.0)
    with pytest.raises(InputError, match="must be one number or three"):
        AccelLine([1.0], 3.0, 1.0)
    resonant = GyroConfig(lines=(GyroLine(20.0, 7.0, 0.5, [1, 2, 2]),)).triad().terms
    assert resonant[0] == (noise.Line(20.0 * DEG / HOUR, 7.0, 0.5, 1),)
    assert resonant[1] == terms[0]
    with pytest.raises(InputError, match="poles = 3: must be 1"):
        GyroLine(1.0, 3.0, 1.0, 3)


def test_units_are_the_datasheets():
    triad = GYRO.triad()
    assert triad.N[0] == pytest.approx(0.3 * DEG / 60)
    assert figures(triad, Flicker, "B")[1] == pytest.approx(2.0 * DEG / HOUR)
    assert figures(triad, RandomWalk, "K")[2] == pytest.approx(30.0 * DEG / HOUR / 60)
    unfiltered = replace(GYRO, bandwidth_hz=None).triad()
    assert figures(unfiltered, Sinusoid, "amplitude") == pytest.approx(
        (50 * DEG / HOUR, 20 * DEG / HOUR, 0.0)
    )
    # A density D per sqrt(Hz) is one-sided: over the Nyquist band the rms is D sqrt(rate/2), which
    # is N sqrt(rate).
    assert ACCEL.triad().N[0] * np.sqrt(200) == pytest.approx(100e-6 * 9.80665 * np.sqrt(100))


def test_drawn_errors_have_their_sizes_and_lifetimes():
    """1 sigma from 3,000 units: relative sampling error 1/sqrt(2 x 9000) = 0.75%, 4.5 of them."""
    triad = GYRO.triad()
    units = [triad.draw_unit(streams.unit(1, u)) for u in range(3000)]
    biases, matrices, of_g = (
        np.array([u[part] for u in units]) for part in ("bias_unit", "matrix", "g_sensitivity")
    )
    assert of_g.std() == pytest.approx(2.0 * DEG / HOUR / 9.80665, rel=0.02)
    assert biases.std() == pytest.approx(1.0 * DEG / HOUR, rel=0.034)
    assert matrices[:, np.eye(3, dtype=bool)].std() == pytest.approx(3e-3, rel=0.034)
    assert matrices[:, ~np.eye(3, dtype=bool)].std() == pytest.approx(5e-3, rel=0.034)
    again = triad.draw_unit(streams.unit(1, 7))
    np.testing.assert_array_equal(again["bias_unit"], biases[7])
    session = triad.draw_session(streams.session(1, 7, 0))
    assert not np.array_equal(session["bias_session"], biases[7])


def test_the_matrix_acts_as_the_papers_equations_say():
    """(I + M) omega + b, with M's first row what the x sensor makes of the truth."""
    triad = replace(GyroConfig(), scale_unit_ppm=1e4, misalignment_unit_mrad=10.0).triad()
    session = {"bias_session": np.full(3, 1e-5)}
    drawn = triad.draw_unit(np.random.default_rng(1)) | session
    errors = triad.draw_run(np.random.default_rng(0), drawn)
    truth = np.array([[1e-3], [2e-3], [-1e-3]])
    printed, _ = triad.measure(np.random.default_rng(2), truth, errors, 1, 0.01)
    expected = truth + errors["matrix"] @ truth + errors["bias_session"][:, None]
    np.testing.assert_allclose(printed, expected, rtol=1e-6)


def test_counts_are_whole_and_clipped_at_the_range():
    triad = replace(GYRO, tone_deg_per_h=0.0, tone_hz=0.0, range_deg_per_s=0.004).triad()
    errors = triad.draw_run(np.random.default_rng(0), triad.none_drawn())
    counts, saturated = triad.measure(
        np.random.default_rng(1), np.full((3, 1), 0.01), errors, 1000, 0.01
    )
    assert counts.dtype == np.int32
    assert np.unique(counts).tolist() == [40]
    assert saturated.all()


def means_and_averages(triad: Triad, rng, draws: int, n: int, block: int, dt: float):
    truth = np.full((3, 1), 3e-5)
    errors = triad.draw_run(rng, triad.none_drawn())
    direct, averaged = np.empty((draws, 3, n)), np.empty((draws, 3, n))
    for d in range(draws):
        direct[d] = triad.measure_means(rng, truth, errors, n, dt, block)
        counts, _ = triad.measure(rng, truth, errors, n * block, dt)
        samples = counts * (triad.output_scale(dt) or 1)
        averaged[d] = samples.reshape(3, n, block).mean(axis=-1)
    return direct - errors["bias_run"][:, None], averaged - errors["bias_run"][:, None]


def test_means_have_the_law_of_averaged_samples_tone_and_counts_included(rng):
    """Mean and spread of the first and last mean and of their difference, 1,500 draws x 3 axes;
    4.5 sampling errors of the difference of two such estimates."""
    config = replace(
        GYRO, tone_deg_per_h=0.0, tone_hz=0.0, rate_lsb_deg_per_s=0.03, ramp_deg_per_h_per_h=0.0
    )
    direct, averaged = means_and_averages(config.triad(), rng, 1500, 4, 10, 0.01)
    for look in (lambda y: y[..., 0], lambda y: y[..., -1], lambda y: y[..., -1] - y[..., 0]):
        a, b = look(direct).ravel(), look(averaged).ravel()
        assert abs(a.mean() - b.mean()) < 4.5 * np.sqrt((a.var() + b.var()) / len(a))
        assert a.var() == pytest.approx(b.var(), rel=4.5 * np.sqrt(4 / len(a)))


def test_means_are_refused_in_the_dead_band_and_at_the_range():
    coarse = replace(GYRO, rate_lsb_deg_per_s=0.2).triad()
    with pytest.raises(InputError, match=r"imu.gyro.rate_lsb_deg_per_s = 0.2 deg/s.*dead band"):
        check_means(coarse, "imu.gyro", 0.01, 1.0, 7e-5)
    with pytest.raises(InputError, match=r"imu.accel.range_g = 0.5 g.*clips"):
        check_means(replace(ACCEL, range_g=0.5).triad(), "imu.accel", 0.01, 1.0, 9.8)
    check_means(GYRO.triad(), "imu.gyro", 0.01, 1.0, 7e-5)


def test_predicted_allan_variance_is_that_of_what_is_printed(rng):
    """Rounding and tone included; 100 recordings, z from their own spread."""
    triad = replace(GYRO, rate_lsb_deg_per_s=0.02, range_deg_per_s=None).triad()
    n, dt = 4000, 0.01
    for m in (1, 10, 100, 1000):
        drawn = []
        for _ in range(100):
            errors = triad.draw_run(rng, triad.none_drawn())
            y = triad.measure(rng, np.full((3, 1), 3e-5), errors, n, dt)[0] * triad.output_scale(dt)
            means = y.reshape(3, n // m, m).mean(axis=-1)
            drawn.append(0.5 * np.mean(np.diff(means, axis=-1) ** 2, axis=-1))
        drawn = np.array(drawn)
        z = (drawn.mean(axis=0) - triad.allan_variance(np.array(m * dt), dt)) / (
            drawn.std(axis=0, ddof=1) / 10
        )
        assert np.abs(z).max() < 4.5, m


def test_a_zero_coefficient_is_no_term():
    assert GyroConfig().triad().terms == ((), (), ())
    assert GyroConfig(arw_deg_per_sqrt_h=[1, 0, 0]).triad().terms[0] == (noise.White(DEG / 60),)


def test_white_noise_may_be_given_in_either_unit():
    """0.3 deg/sqrt(h) is 0.3/60 x sqrt(2) deg/s/sqrt(Hz), one-sided."""
    density = 0.3 / 60 * np.sqrt(2)
    arw = GyroConfig(arw_deg_per_sqrt_h=0.3).triad().N
    np.testing.assert_allclose(GyroConfig(noise_deg_per_s_per_sqrt_hz=density).triad().N, arw)
    GyroConfig(arw_deg_per_sqrt_h=0.3, noise_deg_per_s_per_sqrt_hz=1.1 * density).triad()
    with pytest.raises(InputError, match=r"disagrees by over 15% with arw_deg_per_sqrt_h = 0.3"):
        GyroConfig(arw_deg_per_sqrt_h=0.3, noise_deg_per_s_per_sqrt_hz=1.3 * density).triad()
    vrw = 100e-6 * 9.80665 / np.sqrt(2) * 60
    np.testing.assert_allclose(AccelConfig(vrw_m_per_s_per_sqrt_h=vrw).triad().N, ACCEL.triad().N)


def test_g_sensitivity_acts_on_the_force():
    triad = GyroConfig(g_sensitivity_deg_per_h_per_g=[1.0, 0.0, 0.0]).triad()
    errors = triad.draw_run(
        np.random.default_rng(0),
        triad.none_drawn() | triad.draw_unit(np.random.default_rng(1)),
    )
    force = np.array([[0.0], [0.0], [-9.80665]])
    felt = Surroundings(force)
    printed, _ = triad.measure(np.random.default_rng(2), np.zeros((3, 1)), errors, 1, 0.1, felt)
    np.testing.assert_allclose(printed, errors["g_sensitivity"] @ force, rtol=1e-6)
    assert printed[0] != 0
    assert not printed[1:].any()


def test_carried_counts_lose_nothing_and_are_angle_quantisation(rng):
    """Their sum is the integral to half a count, whatever the count; the Allan variance at two
    samples is 3 (c^2/12)/tau^2 (200 recordings, z from their spread)."""
    config = GyroConfig(arw_deg_per_sqrt_h=1.0, angle_lsb_arcsec=2.0)
    triad, n, dt = config.triad(), 2000, 0.01
    errors = triad.draw_run(rng, triad.none_drawn())
    seed = rng.integers(2**32)
    truth = np.full((3, 1), 3e-5)
    counts, _ = triad.measure(np.random.default_rng(seed), truth, errors, n, dt)
    free = replace(triad, counts=None)
    smooth, _ = free.measure(np.random.default_rng(seed), truth, errors, n, dt)
    total = counts.sum(axis=1) * triad.counts.lsb - smooth.sum(axis=1, dtype=float) * dt
    assert np.abs(total).max() <= triad.counts.lsb * 0.501
    drawn = []
    for _ in range(200):
        y = triad.measure(rng, truth, errors, n, dt)[0] * triad.output_scale(dt)
        means = y.reshape(3, n // 2, 2).mean(axis=-1)
        drawn.append(0.5 * np.mean(np.diff(means, axis=-1) ** 2, axis=-1))
    predicted = triad.allan_variance(np.array(0.02), dt)
    z = (np.mean(drawn, axis=0) - predicted) / (np.std(drawn, axis=0) / np.sqrt(200))
    assert np.abs(z).max() < 4.5


def test_rate_counts_and_angle_counts_are_two_outputs():
    with pytest.raises(InputError, match="are two outputs"):
        GyroConfig(rate_lsb_deg_per_s=0.01, angle_lsb_arcsec=1.0)


def test_warming_up_is_averaged_exactly():
    """Means of the profile over blocks are the profile's means; it ends at the rise."""
    warming = Surroundings(rise_k=12.0, time_s=40.0, since_power_up_s=5.0)
    fine = warming.rise(2000, 0.1).reshape(100, 20).mean(axis=1)
    np.testing.assert_allclose(warming.rise(100, 2.0), fine, rtol=1e-12)
    t = 5.0 + np.arange(3) * 1e-6
    np.testing.assert_allclose(warming.rise(3, 1e-6), 12 * (1 - np.exp(-t / 40)), rtol=1e-6)
    assert warming.rise(10_000, 1.0)[-1] == pytest.approx(12.0)


def test_what_moves_comes_through_the_output_filter_and_what_rests_does_not_notice():
    triad = GyroConfig(bandwidth_hz=5.0).triad()
    errors = triad.draw_run(np.random.default_rng(0), triad.none_drawn())
    ramp = np.linspace(0, 1, 2000) * np.ones((3, 1))
    printed, _ = triad.measure(np.random.default_rng(1), ramp, errors, 2000, 0.01)
    late = (ramp - printed)[:, -1] / (ramp[0, 1] - ramp[0, 0]) * 0.01
    np.testing.assert_allclose(late, 2 * 0.707107 / (2 * np.pi * 5.0), rtol=1e-3)
    still, _ = triad.measure(np.random.default_rng(1), np.full((3, 1), 0.3), errors, 100, 0.01)
    np.testing.assert_allclose(still, 0.3, rtol=1e-6)


def test_means_of_what_moves_are_averages_of_its_samples(rng):
    triad = GyroConfig(bandwidth_hz=5.0, misalignment_unit_mrad=10.0).triad()
    errors = triad.draw_run(rng, triad.none_drawn() | triad.draw_unit(rng))
    moving = np.cumsum(rng.standard_normal((3, 600)), axis=1)
    warm = Surroundings(rise_k=5.0, time_s=3.0)
    fine, _ = triad.measure(rng, moving, errors, 600, 0.01, warm)
    means = triad.measure_means(rng, moving, errors, 20, 0.01, 30, warm)
    np.testing.assert_allclose(means, fine.reshape(3, 20, 30).mean(axis=2), rtol=1e-4, atol=1e-5)
