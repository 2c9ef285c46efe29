"""Generation: what is stored is what was asked for, whatever came before or follows."""

from dataclasses import fields, replace

import numpy as np
import pytest
from helpers import default_config, generate

import sim.generate
import sim.recordings
from lbgc.data.schema import ALWAYS
from lbgc.data.store import Dataset
from lbgc.data.windows import cut
from lbgc.earth import earth_rate_ned
from lbgc.estimators.level import gyrocompass
from lbgc.estimators.static import mean
from lbgc.frames import level, rotation_z, wrap
from lbgc.metrics import heading_errors
from lbgc.protocol import STAGES
from lbgc.sensor import streams
from sim.cluster import ClusterConfig
from sim.generate import GenerateConfig

SMALL = {"recordings": 20, "rate_hz": 50.0, "duration_s": 20.0}


def recording(config: GenerateConfig, i: int) -> dict[str, np.ndarray]:
    return next(sim.recordings.recordings(config, sensor(config), [i]))


def recordings(config: GenerateConfig, count: int) -> list[dict[str, np.ndarray]]:
    """The first ones, made together, as a shard's are: no number depends on that."""
    return list(sim.recordings.recordings(config, sensor(config), range(count)))


def sensor(config: GenerateConfig) -> sim.recordings.Sensor:
    imu = config.imu
    return sim.recordings.Sensor(imu.gyro.triad(), imu.accel.triad(), imu.timing.timing(), config)


@pytest.fixture(scope="module")
def small(tmp_path_factory) -> Dataset:
    return generate(tmp_path_factory.mktemp("small") / "d.zarr", **SMALL)


def test_the_default_is_the_papers_experiment():
    config = default_config()
    assert (config.rate_hz, config.duration_s, config.recordings) == (600.0, 240.0, 80)
    assert config.latitude == 32.76
    assert config.scene.reference_error_deg == 0.2
    assert config.imu.gyro.bias_run_deg_per_h == 1.0


@pytest.mark.parametrize("seed", [0, 1, 2**32, 2**127 + 5, 2**200])
def test_streams_made_together_are_those_made_alone(seed):
    rows = [0, 1, 1000, 2**31, 2**32 - 1]
    for purpose in streams.Purpose:
        together = streams.recordings(seed, rows, purpose)
        alone = [streams.recording(seed, i, purpose) for i in rows]
        np.testing.assert_array_equal(
            *([rng.random(3) for rng in rngs] for rngs in (together, alone))
        )


def test_one_seed_one_digest(tmp_path, small):
    again = generate(tmp_path / "again.zarr", **SMALL)
    other = generate(tmp_path / "other.zarr", **SMALL, seed=2)
    other_unit = generate(tmp_path / "unit.zarr", **SMALL, unit_seed=2)
    assert again.digest() == small.digest()
    assert len({small.digest(), other.digest(), other_unit.digest()}) == 3


def test_a_longer_dataset_begins_with_the_same_recordings(tmp_path, small):
    longer = generate(tmp_path / "longer.zarr", **(SMALL | {"recordings": 30}))
    for name in ALWAYS:
        np.testing.assert_array_equal(longer.label(name)[:20], small.label(name))


def test_going_on_after_an_interruption_gives_the_same_bytes(tmp_path, monkeypatch, small):
    """Killed while a shard is written: nothing is whole, and the second run makes it so."""
    write = Dataset.write_shard

    def killed(self, shard, batch):
        raise KeyboardInterrupt

    monkeypatch.setattr(Dataset, "write_shard", killed)
    with pytest.raises(KeyboardInterrupt):
        generate(tmp_path / "d.zarr", **SMALL)
    assert Dataset.open(tmp_path / "d.zarr").state().missing == [0]
    monkeypatch.setattr(Dataset, "write_shard", write)
    assert generate(tmp_path / "d.zarr", **SMALL).digest() == small.digest()


def test_labels_say_what_the_sensor_felt(small):
    """Printed rates less the drawn errors are Earth's rate at the labelled heading, within the
    noise of 20 s means: N/sqrt(20) = 0.42 deg/h, with flicker, six sigma = 3 deg/h."""
    assert (np.abs(small.label("roll")) < 1e-12).all()
    for i, record in enumerate(small.records(np.arange(20))):
        truth = earth_rate_ned(record.latitude) @ rotation_z(record.heading)
        bias = sum(small.label(f"gyro_bias_{part}")[i] for part in ("unit", "session", "run"))
        expected = truth + small.label("gyro_matrix")[i] @ truth + bias
        assert np.abs(record.gyro.mean(axis=0) - expected).max() < np.deg2rad(3 / 3600)


def test_headings_cover_the_circle_and_the_encoder_says_nothing(tmp_path):
    config = replace(default_config(), output="means", mean_s=240.0, recordings=144)
    rows = recordings(config, 144)
    headings = np.array([row["heading"] for row in rows])
    steps = np.rad2deg(np.diff(np.unwrap(headings)))
    assert np.abs(steps.mean() - 5) < 0.1
    assert np.ptp(np.sort(np.mod(headings, 2 * np.pi))) > np.deg2rad(350)
    assert not any(row["plate_angle"].any() for row in rows)


def test_the_reference_errs_as_the_control_module_does(tmp_path):
    """0.2 degrees, 1 sigma; 300 recordings: 4.5 x 1/sqrt(600) = 18%."""
    config = replace(default_config(), output="means", mean_s=240.0)
    rows = recordings(config, 300)
    errors = np.rad2deg(wrap([r["heading_reference"] - r["heading"] for r in rows]))
    assert errors.std() == pytest.approx(0.2, rel=0.18)


@pytest.mark.parametrize("split_by", ["recording", "session", "unit"])
def test_splits_are_exact_and_what_is_split_by_never_straddles(split_by):
    config = replace(
        default_config(), output="means", mean_s=240.0, split_by=split_by, units=20, sessions=2
    )
    rows = recordings(config, 80)
    split = np.array([int(r["split"]) for r in rows])
    unit = np.array([int(r["unit"]) for r in rows])
    session = np.array([int(r["session"]) for r in rows])
    assert np.bincount(split).tolist() == [56, 8, 16]
    groups = {"recording": np.arange(80), "session": session * 20 + unit, "unit": unit}[split_by]
    for group in np.unique(groups):
        assert len(np.unique(split[groups == group])) == 1


def test_biases_live_as_long_as_they_should():
    config = default_config(
        "imu.gyro.bias_unit_deg_per_h=1",
        "imu.gyro.bias_session_deg_per_h=1",
        "units=2",
        "sessions=2",
        "output=means",
        "mean_s=240",
    )
    rows = recordings(config, 8)
    for name, key in (
        ("gyro_bias_unit", lambda r: int(r["unit"])),
        ("gyro_matrix", lambda r: int(r["unit"])),
        ("gyro_bias_session", lambda r: (int(r["unit"]), int(r["session"]))),
    ):
        seen = {}
        for row in rows:
            np.testing.assert_array_equal(row[name], seen.setdefault(key(row), row[name]))
        assert len({v.tobytes() for v in seen.values()}) == len(seen) > 1
    assert len({r["gyro_bias_run"].tobytes() for r in rows}) == 8


CHANGED = {
    "latitude": 40.0,
    "height_m": 1000.0,
    "rate_hz": 100.0,
    "duration_s": 10.0,
    "recordings": 21,
    "seed": 2,
    "unit_seed": 2,
    "units": 2,
    "sessions": 2,
    "split": [0, 0, 1],
    "split_by": "unit",
    "output": "means",
    "mean_s": 10.0,
    "out": "elsewhere.zarr",
    "cluster": ClusterConfig("local"),
    "imu": "imu=ideal",
    "scene": "scene.reference_error_deg=0.4",
    "protocol": "protocol=static",
}


FIELDS = {f.name for f in fields(GenerateConfig)} - {"calibration"}  # tests/test_my_unit.py


@pytest.mark.parametrize("field", sorted(FIELDS))
def test_every_field_changes_the_dataset(field, tmp_path):
    overrides = ["rate_hz=50", "duration_s=20"]
    base = default_config(*overrides, *(["output=means"] if field == "mean_s" else []))
    change = CHANGED[field]
    if field in ("imu", "scene", "protocol"):
        changed = default_config(*overrides, change)
    else:
        changed = replace(base, **{field: change})
    if field == "out":
        assert sim.generate._out(changed) == "elsewhere.zarr"
        assert changed.content() == base.content()
    elif field == "cluster":  # who does the work, and nothing of the result
        assert changed.content() == base.content()
    elif field == "recordings":
        layout = sim.generate._layout
        own = sensor(base)
        assert layout(changed, own).recordings == layout(base, own).recordings - 59
    else:
        before, after = (recordings(c, 20) for c in (base, changed))
        assert any(
            b[name].shape != a[name].shape or (b[name] != a[name]).any()
            for b, a in zip(before, after, strict=True)
            for name in ALWAYS
        )


def test_the_baseline_is_the_papers(tmp_path):
    """All 80 recordings of the default dataset, 240 s: the paper's median is 3.41 degrees."""
    dataset = generate(tmp_path / "d.zarr", output="means", mean_s=240.0)
    sizes = [
        float(abs(heading_errors(mean(cut(r, 240.0)).heading, np.array([r.heading]))[0]))
        for r in dataset.records(np.arange(80))
    ]
    assert 2.1 < np.rad2deg(np.median(sizes)) < 4.6


def test_thirty_experiments_agree_on_the_median(tmp_path):
    """Mean over 30 seeds of the median over 80 recordings, 1 deg/h of run bias: 3.0 to 3.4. Its
    own sampling error is 3.2 x 1.17/sqrt(2 x 80 x 30) = 0.05."""
    medians = []
    for seed in range(30):
        config = replace(default_config(), output="means", mean_s=240.0, seed=seed)
        rows = recordings(config, 80)
        gyro, accel = (np.array([r[n] for r in rows]) for n in ("gyro", "accel"))
        estimate = gyrocompass(gyro[:, 0], *level(accel[:, 0]))
        errors = wrap(estimate - [r["heading"] for r in rows])
        medians.append(np.rad2deg(np.median(np.abs(errors))))
    assert 3.0 < np.mean(medians) < 3.4


def test_means_and_samples_are_the_same_sensor(tmp_path):
    """One shard each way, the same draws of bias: block-averaged samples agree with means within
    the in-run noise of 20 s (six sigma, 3 deg/h)."""
    config = replace(default_config(), rate_hz=50.0, duration_s=20.0)
    for i in range(5):
        full = recording(config, i)
        means = recording(replace(config, output="means", mean_s=20.0), i)
        lsb = config.imu.gyro.triad().counts.lsb
        for name in ("gyro_bias_run", "gyro_matrix", "heading", "heading_reference"):
            np.testing.assert_array_equal(full[name], means[name])
        difference = full["gyro"].mean(axis=0) * lsb - means["gyro"][0]
        assert np.abs(difference).max() < np.deg2rad(3 / 3600)


def test_timestamps_jitter_and_samples_get_lost():
    """5% of 5,000 samples within 4.5 sampling errors; a lost one repeats the last that came."""
    config = default_config("rate_hz=50", "duration_s=100")
    asked = default_config(
        "rate_hz=50", "duration_s=100", "imu.timing.jitter_s=1e-3", "imu.timing.dropped_share=0.05"
    )
    whole, torn = recording(config, 3), recording(asked, 3)
    lost = torn["lost"].astype(bool)
    assert lost.mean() == pytest.approx(0.05, abs=4.5 * np.sqrt(0.05 * 0.95 / 5000))
    np.testing.assert_array_equal(torn["gyro"][~lost], whole["gyro"][~lost])
    np.testing.assert_array_equal(torn["accel"][1:][lost[1:]], torn["accel"][:-1][lost[1:]])
    assert torn["time_error"].std() == pytest.approx(1e-3, rel=4.5 / np.sqrt(10_000))
    assert not whole["time_error"].any()
    assert not whole["lost"].any()


def test_timestamps_are_printed_in_order():
    config = default_config("rate_hz=50", "duration_s=20", "imu.timing.jitter_s=0.1")
    assert (np.diff(np.arange(1, 1001) / 50 + recording(config, 0)["time_error"]) > -1e-12).all()


def test_a_moving_recording_carries_angle_stage_and_truth():
    config = default_config("protocol=two_position", "rate_hz=50", "duration_s=40")
    row = recording(config, 0)
    angle, stage = row["plate_angle"], row["stage"]
    assert angle[0] == 0
    assert angle[-1] == pytest.approx(np.pi, abs=1e-9)
    assert [STAGES[s] for s in stage[np.flatnonzero(np.diff(stage, prepend=9))]] == [
        "rest",
        "slew",
        "settle",
        "rest",
    ]
    # what was printed less its bias, at either rest, is Earth's rate at that heading: in-run noise
    # of 16 s means, six sigma = 3 deg/h
    bias = sum(row[f"gyro_bias_{part}"] for part in ("unit", "session", "run"))
    lsb = config.imu.gyro.triad().counts.lsb
    for rest in (slice(0, 800), slice(-800, None)):
        heading = row["heading"] + angle[rest].mean()
        truth = earth_rate_ned(row["latitude"]) @ rotation_z(heading)
        printed = row["gyro"][rest].mean(axis=0) * lsb - row["gyro_matrix"] @ truth - bias
        assert np.abs(printed - truth).max() < np.deg2rad(3 / 3600)
    assert np.abs(row["attitude"]).max() < 1e-6


@pytest.mark.parametrize(
    "options",
    [
        (),
        ("scene=vibrating_floor",),
        ("scene=moored",),
        (
            "imu.temperature.rise_k=20",
            "imu.temperature.time_s=20",
            "imu.gyro.scale_per_k_ppm_per_k=500",
        ),
        ("imu.gyro.bandwidth_hz=2", "imu.accel.bandwidth_hz=2"),
    ],
)
def test_means_of_a_moving_recording_are_averages_of_its_samples(options):
    """A perfect sensor: block means, stages and angles are those of the samples."""
    moving = ("imu=ideal", "protocol=two_position", "rate_hz=50", "duration_s=40", *options)
    fine = recording(default_config(*moving), 2)
    means = recording(default_config(*moving, "output=means", "mean_s=2"), 2)
    for name in ("gyro", "accel", "plate_angle", "attitude"):
        blocks = fine[name].reshape(20, 100, *fine[name].shape[1:]).mean(axis=1)
        np.testing.assert_allclose(means[name], blocks, atol=3e-7 * np.abs(blocks).max())
    assert set(means["stage"]) == {0, 1, 2}


def test_a_vehicle_sways_and_says_how_much():
    config = default_config("scene=vehicle", "scene.sway.level=[0.5,1.5]", "protocol=static",
                            "rate_hz=100", "duration_s=10", "scene.physics_hz=400")  # fmt: skip
    rows = list(sim.recordings.recordings(config, sensor(config), range(3)))
    levels = [float(r["sway_level"]) for r in rows]
    assert len(set(levels)) == 3
    assert all(0.5 <= level <= 1.5 for level in levels)
    assert all(np.ptp(r["attitude"], axis=0).min() > 0 for r in rows)
    again = recording(config, 1)
    for name in ALWAYS:
        np.testing.assert_array_equal(again[name], rows[1][name])


def test_at_the_pole_generation_warns(cli):
    done = cli("sim.generate", "latitude=90", "recordings=1", "rate_hz=10", "duration_s=10")
    assert done.code == 0
    assert "heading does not exist" in done.err


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("latitude=91", "latitude = 91.0 deg: must be from -90 to 90"),
        ("height_m=1e6", "height_m = 1000000.0 m: must be from -12000 to 100000"),
        ("latitude=nan", "latitude = nan deg: must be a finite number"),
        ("imu=nonesuch", "\tideal\n"),
        ("imu.gyro.arw=3", "key = imu.gyro.arw: choose from arw_deg_per_sqrt_h"),
        ("latitud=3", "key = latitud: choose from"),
        ("recordings=ten", "recordings = ten: must be a whole number"),
        ("recordings=0", "recordings = 0: must be greater than zero"),
        ("imu.gyro.arw_deg_per_sqrt_h=-0.1", "-0.1 deg/sqrt(h): must not be negative"),
        ("imu.gyro.arw_deg_per_sqrt_h=nan", "nan deg/sqrt(h): must be a finite number"),
        ("rate_hz=500", "rate_hz = 500.0 Hz: each sample must be a whole number of physics steps"),
        ("duration_s=1.0001", "duration_s = 1.0001 s: must be a whole number of samples"),
        ("split=[1,2]", "must be three shares"),
        ("split_by=day", "choose from recording, session, unit"),
        ("output=mean", "choose from samples, means"),
        ("protocol.step_deg=-5", "protocol.step_deg = -5.0 deg"),
        ("latitude=[", "latitude=[: no viable alternative"),
        ("seed=-1", "seed = -1: must not be negative"),
        ("imu.timing.dropped_share=1", "imu.timing.dropped_share = 1.0: must be below 1"),
    ],
)
def test_bad_input_is_named_and_leaves_nothing_behind(cli, tmp_path, override, says):
    done = cli("sim.generate", "out=d.zarr", "duration_s=10", "rate_hz=10", override)
    assert done.code == 2
    assert says in done.err
    assert "Traceback" not in done.err
    assert list(tmp_path.iterdir()) == []


def test_means_cannot_lose_samples(cli, tmp_path):
    done = cli("sim.generate", "output=means", "imu.timing.jitter_s=0.001")
    assert done.code == 2
    assert "imu.timing.jitter_s = 0.001 s: is of samples; use output=samples" in done.err


def test_an_out_of_another_configuration_is_refused_and_kept(cli, tmp_path):
    size = ("recordings=1", "rate_hz=10", "duration_s=10", "out=d.zarr")
    assert cli("sim.generate", *size).code == 0
    digest = Dataset.open(tmp_path / "d.zarr").digest()
    done = cli("sim.generate", *size, "seed=9")
    assert done.code == 2
    assert "holds a dataset of another configuration" in done.err
    assert Dataset.open_finished(tmp_path / "d.zarr").digest() == digest
    (tmp_path / "file").write_text("mine")
    assert "is a file" in cli("sim.generate", *size[:3], "out=file").err


def test_a_sweep_makes_every_dataset_and_survives_one_bad_job(cli, tmp_path):
    done = cli(
        "sim.generate",
        "--multirun",
        "latitude=0,91,32.76,60",
        "recordings=1",
        "rate_hz=10",
        "duration_s=10",
    )
    assert done.code == 2
    assert "latitude = 91.0 deg" in done.err
    made = sorted((tmp_path / "outputs" / "generate").glob("*/dataset.zarr"))
    made = [m for m in made if not m.parent.is_symlink()]
    latitudes = {float(np.rad2deg(Dataset.open_finished(m).label("latitude")[0])) for m in made}
    assert {round(x, 9) for x in latitudes} == {0.0, 32.76, 60.0}


def test_the_last_line_printed_is_the_path(cli, tmp_path):
    done = cli("sim.generate", "recordings=1", "rate_hz=10", "duration_s=10")
    assert Dataset.open_finished(tmp_path / done.last_line).rate_hz == 10.0
    assert (tmp_path / "outputs/generate/latest/dataset.zarr").exists()


def test_help_describes_every_parameter(cli):
    said = cli("sim.generate", "--help").out
    described = said[: said.index("Groups to choose from")]
    for field in fields(GenerateConfig):
        where = said if field.name in ("imu", "scene", "protocol") else described
        assert field.name in where, field.name


@pytest.mark.parametrize(
    ("imu", "override", "expected"),
    [
        ("sdc500", "imu.gyro.noise_deg_per_s_per_sqrt_hz=0.01", 0.01 * 60 / 2**0.5),
        ("bmi160", "imu.gyro.arw_deg_per_sqrt_h=0.5", 0.5),
    ],
)
def test_a_figure_on_the_command_line_replaces_the_presets_in_whatever_unit(
    cli, tmp_path, imu, override, expected
):
    size = ("recordings=1", "rate_hz=10", "duration_s=10", "out=d.zarr")
    assert cli("sim.generate", f"imu={imu}", override, *size).code == 0
    stored = Dataset.open(tmp_path / "d.zarr").configuration["imu"]["gyro"]
    density = stored["noise_deg_per_s_per_sqrt_hz"]
    arw = stored["arw_deg_per_sqrt_h"]
    assert (arw if density is None else density * 60 / 2**0.5) == pytest.approx(expected)
    assert None in (arw, density)
    both = cli("sim.generate", *size[:3], override, "imu.gyro.noise_deg_per_s_per_sqrt_hz=3",
               "imu.gyro.arw_deg_per_sqrt_h=0.5")  # fmt: skip
    assert both.code == 2
    assert "disagrees by over 15%" in both.err
