"""What other tools make of an exported sensor, by their own documentation, is as the files say."""

import json
import re
from dataclasses import fields, replace
from pathlib import Path
from xml.etree import ElementTree

import exported
import numpy as np
import pytest
import yaml
from exported import AXES, PARTS, READERS, Model, claims, of_axes
from helpers import ROOT, composed, default_config, generate

import lbgc.fit
from lbgc.errors import InputError, build
from lbgc.export_imu import ExportImuConfig
from lbgc.exports import FORMATS, written
from lbgc.exports.losses import COUNTS, RANGE, WALK, WHITE
from lbgc.exports.subject import Subject, stretches
from lbgc.sensor import kalibr
from lbgc.sensor.datasheet import ALTERNATIVES, AccelConfig, GyroConfig, ImuConfig
from lbgc.sensor.stand_in import FAR

RATE, LONGEST_S = 200.0, 82.0
PRESETS = ("stim300", "sdc500", "adis16405", "lasergyro", "hg9900", "ideal")
SIGMAS = 4.5
"""Standard errors that a mean of many series may be off: 2 in 100,000 are further, of some 400."""


def subject(gyro=None, accel=None, rate_hz=RATE, longest_s=LONGEST_S, **others) -> Subject:
    """A sensor with these keys of its triads."""
    triads = {"gyro": GyroConfig(**(gyro or {})), "accel": AccelConfig(**(accel or {}))}
    return Subject(ImuConfig(name="mine", **triads, **others), rate_hz, longest_s)


def preset(name: str) -> Subject:
    return Subject(default_config(f"imu={name}").imu, RATE, LONGEST_S)


def models(name: str, own: Subject) -> dict[str, list[Model]]:
    return READERS[name](FORMATS[name].text(own), own.dt)


def deviations(own: Subject, part: str, shared: bool) -> np.ndarray:
    """Our Allan deviations at the octaves, (3, L); of the worst axis where all share one figure."""
    variance = own.triad(part).allan_variance(own.octaves, own.dt)
    return np.sqrt(np.broadcast_to(variance.max(axis=0), variance.shape) if shared else variance)


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("imu", PRESETS)
def test_an_export_has_the_sensors_allan_deviation_where_its_file_says_so_and_nowhere_else(
    imu, name
):
    """The tool's samples' law is calculated from the file alone; the file's sentence is held to it
    at every octave."""
    own = preset(imu)
    text = FORMATS[name].text(own)
    said = claims(text, own.octaves)
    assert set(said) == {(part, axis) for part in PARTS for axis in AXES}
    for part, found in READERS[name](text, own.dt).items():
        ours = deviations(own, part, len(found) == 1)
        for axis, model, deviation in zip(AXES, of_axes(found), ours, strict=True):
            theirs = [model.allan_variance(round(tau / own.dt)) for tau in own.octaves]
            low, high = deviation**2 / 1.05**2, deviation**2 * 1.05**2
            held = (low * (1 - 1e-6) <= theirs) & (theirs <= high * (1 + 1e-6))
            np.testing.assert_array_equal(held, said[part, axis], f"{part} {axis}")


def test_what_a_format_can_express_is_exact_at_every_octave():
    """White noise and a walk, in all but ROS's; one process, in those that simulate one."""
    walks = subject(
        {"arw_deg_per_sqrt_h": [0.1, 0.2, 0.05], "rrw_deg_per_h_per_sqrt_h": [3, 6, 1.5]},
        {"vrw_m_per_s_per_sqrt_h": 0.05, "random_walk_ug_per_sqrt_h": 900},
    )
    wanders = subject(
        {"arw_deg_per_sqrt_h": 0.1, "gauss_markov_deg_per_h": [5, 2, 1], "gauss_markov_s": 30},
        {"noise_ug_per_sqrt_hz": 50, "gauss_markov_ug": 40, "gauss_markov_s": 8},
    )
    for own, names in (
        (walks, set(FORMATS) - {"ros"}),
        (wanders, {"gazebo", "matlab", "gnss_ins_sim"}),
    ):
        for name in names:
            for part, found in models(name, own).items():
                ours = deviations(own, part, len(found) == 1)
                for model, deviation in zip(of_axes(found), ours, strict=True):
                    theirs = [model.allan_variance(round(tau / own.dt)) for tau in own.octaves]
                    # A walk's value at a sample's time is no mean over it: 1 + 1/(2 m^2), of little
                    ratio = np.sqrt(theirs) / deviation
                    np.testing.assert_allclose(ratio, 1, rtol=2e-3, err_msg=f"{name} {part}")


@pytest.mark.parametrize("name", FORMATS)
def test_simulated_side_by_side(name):
    """Series of the tool's samples, and series of ours, at every octave: theirs have the law that
    the file was held to, and where the file says that they agree with ours, they do, within 5% and
    the standard error of both."""
    own = Subject(default_config("imu=bmi160").imu, 20.0, 103.0)
    count, n, settled = 48, 4096, 2048
    m = np.round(own.octaves / own.dt).astype(int)
    text = FORMATS[name].text(own)
    said = claims(text, own.octaves)
    rng = np.random.Generator(np.random.SFC64(19))
    for part, found in READERS[name](text, own.dt).items():
        triad = own.triad(part)
        drawn = triad.draw_run(
            [rng] * count, {k: np.stack([v] * count) for k, v in triad.none_drawn().items()}
        )
        model = of_axes(found)[0]
        theirs, spread = variances(model.simulate(rng, (count, n + settled))[:, settled:], m)
        law = np.array([model.allan_variance(k) for k in m])
        assert (np.abs(theirs - law) < SIGMAS * spread).all(), (part, (theirs - law) / spread)
        printed = np.stack([
            triad.measure(rng, np.zeros((3, 1)), {k: v[i] for k, v in drawn.items()}, n, own.dt)[0]
            for i in range(count)
        ])  # fmt: skip
        ours, beside = variances(printed[:, 0] * (triad.output_scale(own.dt) or 1.0), m)
        error = SIGMAS * np.hypot(spread / theirs, beside / ours)
        agree = np.abs(np.log(theirs / ours)) < 2 * np.log(1.05) + error
        assert agree[said[part, "forward"]].all(), part
        assert said[part, "forward"].sum() >= 4


def variances(series: np.ndarray, m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The Allan variances of series (R, n) over m samples (L,), and their standard errors."""
    each = []
    for k in m:
        means = series[:, : series.shape[1] // k * k].reshape(len(series), -1, k).mean(axis=2)
        each.append(np.mean(np.diff(means, axis=1) ** 2, axis=1) / 2)
    every = np.stack(each, axis=1)
    return every.mean(axis=0), every.std(axis=0, ddof=1) / np.sqrt(len(every))


def test_each_tools_own_meaning_of_a_density():
    """0.3 deg/sqrt(h), two-sided, is 8.727e-5 rad/sqrt(s); a walk of 6 deg/h/sqrt(h) 4.848e-7."""
    own = subject(
        {"arw_deg_per_sqrt_h": 0.3, "rrw_deg_per_h_per_sqrt_h": 6},
        {"noise_ug_per_sqrt_hz": 100, "random_walk_ug_per_sqrt_h": 60},
    )
    N, K = np.deg2rad(0.3) / 60, np.deg2rad(6) / 3600 / 60
    accel_N = 100e-6 * 9.80665 / np.sqrt(2)  # a data sheet's density is one-sided
    text = {name: FORMATS[name].text(own) for name in FORMATS}
    keys = yaml.safe_load(text["kalibr"])
    assert keys["gyroscope_noise_density"] == pytest.approx(N)
    assert keys["gyroscope_random_walk"] == pytest.approx(K)
    assert keys["accelerometer_noise_density"] == pytest.approx(accel_N)
    covariances = yaml.safe_load(text["gtsam"])
    assert covariances["gyroscopeCovariance"][1][1] == pytest.approx(N**2)
    assert covariances["biasOmegaCovariance"][2][2] == pytest.approx(K**2)
    message = yaml.safe_load(text["ros"])
    assert message["angular_velocity_covariance"][4] == pytest.approx(N**2 * RATE)
    noise = ElementTree.fromstring(text["gazebo"]).find("sensor/imu/angular_velocity/y/noise")
    assert float(noise.findtext("stddev")) == pytest.approx(N * np.sqrt(RATE))
    assert float(noise.findtext("dynamic_bias_stddev")) == pytest.approx(K)
    px4 = {
        r.split("\t")[2]: float(r.split("\t")[3]) for r in text["px4"].splitlines() if r[0] != "#"
    }
    assert px4["EKF2_GYR_NOISE"] == pytest.approx(N / 0.1)
    assert px4["EKF2_GYR_B_NOISE"] == pytest.approx(K / 0.1)
    ardupilot = dict(r.split(",") for r in text["ardupilot"].splitlines() if r[0] != "#")
    assert float(ardupilot["EK3_GYRO_P_NSE"]) == pytest.approx(N / np.sqrt(0.012))
    assert float(ardupilot["EK3_GBIAS_P_NSE"]) == pytest.approx(K / np.sqrt(0.012))
    part = json.loads(text["matlab"])["lbgc"]
    assert part["Accelerometer"]["NoiseDensity"] == pytest.approx([100e-6 * 9.80665] * 3)
    assert part["Gyroscope"]["RandomWalk"] == pytest.approx([K / np.sqrt(2)] * 3)
    assert f"'arw': np.array([{N:.8e}" in text["gnss_ins_sim"]


def test_kalibrs_file_is_read_back_as_the_sensor():
    own = subject(
        {"arw_deg_per_sqrt_h": 0.3, "rrw_deg_per_h_per_sqrt_h": 6},
        {"vrw_m_per_s_per_sqrt_h": 0.03, "random_walk_ug_per_sqrt_h": 60},
    )
    again = kalibr.adopted(yaml.safe_load(FORMATS["kalibr"].text(own)))
    assert again["gyro"]["arw_deg_per_sqrt_h"] == pytest.approx(0.3)
    assert again["gyro"]["rrw_deg_per_h_per_sqrt_h"] == pytest.approx(6)
    assert again["accel"]["vrw_m_per_s_per_sqrt_h"] == pytest.approx(0.03)
    assert again["accel"]["random_walk_ug_per_sqrt_h"] == pytest.approx(60)


def test_one_figure_for_three_axes_is_the_worst_ones():
    own = subject({"arw_deg_per_sqrt_h": [0.1, 0.3, 0.2], "rrw_deg_per_h_per_sqrt_h": [9, 1, 1]})
    text = FORMATS["kalibr"].text(own)
    keys = yaml.safe_load(text)
    assert keys["gyroscope_noise_density"] == pytest.approx(np.deg2rad(0.3) / 60)
    assert keys["gyroscope_random_walk"] == pytest.approx(np.deg2rad(9) / 3600 / 60)
    assert "of white noise that is the right one" in text


def every_key(config: type) -> dict:
    """A value for every key of a triad, one of those that say the same."""
    shares = [sorted(group)[:-1] for group in ALTERNATIVES]
    left_out = {"lines", *(key for keys in shares for key in keys)}
    names = [row.name for row in fields(config) if row.name not in left_out]
    counts = [n for n in names if n in ("angle_lsb_arcsec", "velocity_lsb_m_per_s")]
    return {n: 0.37 for n in names if n not in counts} | {"flicker_long_s": 900.0, "tone_hz": 7.0}


@pytest.mark.parametrize("name", FORMATS)
def test_every_stated_key_is_told_or_said_to_be_replaced_or_lost(name):
    field = {"magnetic_field": {"horizontal_gauss": 0.2}, "temperature": {"rise_k": 10.0},
             "timing": {"jitter_s": 1e-4}}  # fmt: skip
    gyro, accel = every_key(GyroConfig), every_key(AccelConfig)
    config = build(ImuConfig, {"name": "mine", "gyro": gyro, "accel": accel, **field})
    text = FORMATS[name].text(Subject(config, RATE, LONGEST_S))
    told = (
        WHITE | COUNTS | (set() if name == "ros" else WALK) | (RANGE if name == "matlab" else set())
    )
    for part, keys in (("gyro", gyro), ("accel", accel)):
        for key in keys:
            said = re.search(rf"(?:lost|replaced by [^:]*): {part}\.{key} = ", text)
            assert said or key in told, f"{part}.{key}"
    for key in ("magnetic_field.horizontal_gauss", "temperature.rise_k", "timing.jitter_s"):
        assert f"lost: {key} = " in text


def test_lines_and_tones_are_lost_by_their_figures():
    line = {"deg_per_h": 60.0, "hz": 17.0, "width_hz": 2.0}
    gyro = {"arw_deg_per_sqrt_h": 0.1, "lines": [line], "tone_hz": 5.0, "tone_deg_per_h": 30.0}
    own = Subject(build(ImuConfig, {"name": "mine", "gyro": gyro}), RATE, LONGEST_S)
    text = FORMATS["kalibr"].text(own)
    assert "lost: gyro.lines = deg_per_h 60.0, hz 17.0, width_hz 2.0, poles 2" in text
    assert "lost: gyro.tone_deg_per_h = 30.0 deg/h" in text
    assert yaml.safe_load(text)["gyroscope_noise_density"] == pytest.approx(np.deg2rad(0.1) / 60)


def test_a_walk_of_the_sensors_own_is_told_and_stands_for_nothing():
    own = subject({"arw_deg_per_sqrt_h": 0.1, "rrw_deg_per_h_per_sqrt_h": 6,
                   "bias_instability_deg_per_h": 2.0}, {"bias_instability_ug": 50.0})  # fmt: skip
    text = FORMATS["kalibr"].text(own)
    assert "lost: gyro.bias_instability_deg_per_h = 2.0 deg/h" in text
    assert "replaced by the random walk: accel.bias_instability_ug = 50.0 ug" in text
    assert "Kalibr divides" not in text
    two = {"rrw_deg_per_h_per_sqrt_h": [6, 0, 3], "bias_instability_deg_per_h": 2.0}
    mixed = subject({"arw_deg_per_sqrt_h": 0.1, **two})
    lost = "lost: gyro.bias_instability_deg_per_h"
    assert [lost in FORMATS[name].text(mixed) for name in ("kalibr", "px4", "gtsam")] == [1, 1, 0]
    assert "gyro: the sensor is stated with no drift" in FORMATS["kalibr"].text(
        subject({"arw_deg_per_sqrt_h": 0.1})
    )


def test_gazebos_bias_of_the_start_fades_so_it_is_the_drifts_own():
    bias = {"bias_session_deg_per_h": 30.0}
    white = {"arw_deg_per_sqrt_h": 0.1}
    size = np.deg2rad(30 / 3600)
    stays, walks = (
        models("gazebo", subject({**white, **bias, **more}))["gyro"][0]
        for more in ({}, {"rrw_deg_per_h_per_sqrt_h": 6.0})
    )
    assert stays.start == walks.start == pytest.approx(size)
    assert 1 - walks.pole == pytest.approx(1 / RATE / (FAR * 81.92), rel=0.01)
    text = FORMATS["gazebo"].text(subject({**white, **bias}))
    assert "replaced by bias_stddev, which has all lifetimes together: gyro.bias_session" in text
    own = subject({**white, **bias, "bias_instability_deg_per_h": 2.0})
    fades = models("gazebo", own)["gyro"][0]
    assert fades.start == pytest.approx(fades.kick / np.sqrt(1 - fades.pole**2), rel=1e-5)
    text = FORMATS["gazebo"].text(own)
    assert f"turn-on bias is lost (1 sigma: forward {size:.8e}" in text
    assert "lost: gyro.bias_session_deg_per_h" in text


def test_gazebo_rounds_only_what_it_does_not_take_for_nothing():
    fine = subject({"arw_deg_per_sqrt_h": 0.1, "rate_lsb_deg_per_s": 5e-5})  # 8.7e-7 rad/s
    coarse = subject({"arw_deg_per_sqrt_h": 0.1, "rate_lsb_deg_per_s": 1e-3})
    assert models("gazebo", fine)["gyro"][0].resolution == 0
    assert "gyro: rounding to counts is among the white noise" in FORMATS["gazebo"].text(fine)
    assert models("gazebo", coarse)["gyro"][0].resolution == pytest.approx(np.deg2rad(1e-3))
    assert "rounding to counts" not in FORMATS["gazebo"].text(coarse)


def test_matlabs_part_has_what_loadparams_takes():
    """Numbers and "inf" in the two groups; other groups' names do not contain theirs."""
    (part,) = json.loads(FORMATS["matlab"].text(preset("stim300"))).values()
    groups = [part.pop("Accelerometer"), part.pop("Gyroscope")]
    for value in (value for group in groups for value in group.values()):
        assert value == "inf" or np.asarray(value).dtype.kind in "fi"
    assert not [name for name in part if re.search("Accelerometer|Gyroscope|Magnetometer", name)]


def test_texts_of_the_sensor_stay_in_their_comments():
    odd = "a --> <b> & 'c' *) # %"
    own = subject({"arw_deg_per_sqrt_h": 0.1}, assumed="one\nimu0: {}\n-->")
    own = replace(own, config=replace(own.config, name=odd))
    for name, reader in READERS.items():
        reader(FORMATS[name].text(own), own.dt)
    root = ElementTree.fromstring(FORMATS["gazebo"].text(own))
    assert [child.tag for child in root] == ["sensor"]
    assert list(yaml.safe_load(FORMATS["kalibr"].text(own)))[-1] == "update_rate"


def test_px4_is_told_what_is_outside_its_ranges():
    text = FORMATS["px4"].text(preset("hg9900"))
    assert re.search(r"EKF2_GYR_NOISE, rad/s: .* and 5.82e-06 is outside", text)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["format=[kalib]"], "format = kalib: choose from kalibr, openvins"),
        (["format=[ros,ros]"], "must name each format once"),
        (["format=[]"], "format = []: choose from kalibr"),
        (["rate_hz=0"], "rate_hz = 0.0 Hz: must be greater than zero"),
        (["longest_s=0.01"], "longest_s = 0.01 s: must be 0.08 s or more, 16 samples at 200 Hz"),
    ],
)
def test_what_cannot_be_exported_is_refused(cli, options, said):
    done = cli("lbgc.export_imu", *options)
    assert (done.code, said in done.err) == (2, True), done.err


def test_the_command_writes_what_the_formats_say(cli, tmp_path):
    done = cli("lbgc.export_imu", "imu=stim300", "format=[kalibr,gazebo]", "longest_s=82")
    assert done.code == 0, done.err
    config = composed(ExportImuConfig, "export_imu", "imu=stim300", "longest_s=82")
    directory = tmp_path / done.last_line
    assert {p.name: p.read_text() for p in directory.iterdir()} == written(
        config.subject, ["kalibr", "gazebo"]
    )
    assert config.format == list(FORMATS)
    assert "imu.yaml: 11 keys are lost" in done.out


def test_the_choices_in_words_are_those_there_are():
    for name in ("export_imu", "fit"):
        said = yaml.safe_load((ROOT / "conf" / f"{name}.yaml").read_text())["hydra"]["help"]
        words = re.findall(r"[a-z0-9_]+", said["template"])
        assert set(FORMATS) <= set(words), name
    assert set(READERS) == set(FORMATS)
    files = [own.file for own in FORMATS.values()]
    assert len(set(files)) == len(files)


def test_a_fit_is_exported_as_its_sensor_is(cli, tmp_path, monkeypatch):
    monkeypatch.setattr(lbgc.fit.allan_page, "draw", lambda *_: {})  # most of the time
    generate(tmp_path / "d.zarr", recordings=1, rate_hz=10.0, duration_s=64.0, split=[0, 0, 1])
    done = cli("lbgc.fit", "data=d.zarr", "export=[kalibr,ros]", "processes=1")
    assert done.code == 0, done.err
    directory = tmp_path / done.last_line
    sensor = build(ImuConfig, yaml.safe_load((directory / "imu/mine.yaml").read_text()))
    for name, text in written(Subject(sensor, 10.0), ["kalibr", "ros"]).items():
        lines = (directory / "export" / name).read_text().splitlines(keepends=True)
        fitted = [line for line in lines if "fitted, 95% intervals behind: " in line]
        assert any(
            re.search(r": gyro\.arw_deg_per_sqrt_h: \[.*\]  # [\d.]+\.\.[\d.]+, ", f)
            for f in fitted
        )
        assert "".join(line for line in lines if line not in fitted) == text
    curve = cli("lbgc.fit", "curve.gyro=sheet.csv", "export=[ros]")
    assert "export = ['ros']: is for a log or a dataset" in curve.err
    refused = cli("lbgc.fit", "data=d.zarr", "export=[csv]")
    assert (refused.code, "export = csv: choose from kalibr" in refused.err) == (2, True)


def test_stretches_in_words():
    tau = np.array([0.01, 0.02, 0.04, 0.08])
    for held, said in (
        ([1, 1, 1, 1], "0.01 to 0.08 s"),
        ([1, 0, 1, 1], "0.01 s and 0.04 to 0.08 s"),
        ([0, 0, 0, 0], ""),
    ):
        assert stretches(tau, np.array(held, bool)) == said


def test_a_subject_is_of_samples():
    with pytest.raises(InputError, match="rate_hz"):
        subject(rate_hz=-1.0)
    assert Path(exported.__file__).read_text().count("import lbgc") == 0
