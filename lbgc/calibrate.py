"""What repeats of one unit's gyro error, and what taking it out does to the heading.

python lbgc/calibrate.py means=FILE latitude=32.76
python lbgc/calibrate.py data=PATH
"""

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from lbgc.data import logs
from lbgc.data.record import Record
from lbgc.data.store import Dataset
from lbgc.errors import InputError, require, run_main
from lbgc.outputs import as_json, fingerprint, mark_latest, task_directory, write_atomically
from lbgc.sensor.calibration import Calibration, calibrate
from lbgc.units import DEG, HOUR

FEWEST = 6
COLUMNS = ("heading_deg", "gyro_x_deg_s", "gyro_y_deg_s", "gyro_z_deg_s")


@dataclass(frozen=True)
class CalibrateConfig:
    """What `conf/calibrate.yaml` holds."""

    means: str | None = None
    """A CSV file of recording means: heading_deg, gyro_x_deg_s, gyro_y_deg_s, gyro_z_deg_s, and
    session (which power-up) where that is known."""
    latitude: float | None = None
    """degrees, of those means"""
    data: str | None = None
    """Or a dataset of resting recordings of one unit; its references are the headings."""
    log: logs.LogConfig | None = None
    """Or recordings with known headings, such as log=sdc500."""

    def __post_init__(self) -> None:
        given = [name for name in ("means", "data", "log") if getattr(self, name) is not None]
        require(len(given) == 1, "means, data or log", given or "nothing", "give one of them")
        if self.means is not None:
            require(self.latitude is not None, "latitude", None, "must be given with means=FILE")


def main(config: CalibrateConfig) -> Path:
    """Calibrate, print what was found, write it as JSON; return the file."""
    rates, heading, latitude, session, name = _read(config)
    if len(rates) < FEWEST:
        raise InputError(name, len(rates), "recordings", f"are too few: {FEWEST} at the least")
    found = calibrate(rates, heading, latitude, session)
    print(report(found, name))
    directory = task_directory("calibrate", fingerprint({**asdict(config), "name": name}))
    write_atomically(directory / "calibration.json", as_json(vars(found)) + "\n")
    mark_latest(directory)
    return directory / "calibration.json"


def _read(config: CalibrateConfig) -> tuple[np.ndarray, np.ndarray, float, np.ndarray | None, str]:
    """Mean rates (R, 3) in rad/s, headings (R,) and latitude in rad, sessions (R,) where known, and
    what they are from."""
    if config.means is not None:
        assert config.latitude is not None
        table = logs.columns(config.means, COLUMNS, optional=("session",))
        session = table[:, 4] if table.shape[1] > 4 else None
        rates, heading = table[:, 1:4] * DEG, table[:, 0] * DEG
        return rates, heading, config.latitude * DEG, session, config.means
    if config.data is not None:
        dataset = Dataset.open_finished(config.data)
        units = len(np.unique(dataset.label("unit")))
        require(units == 1, "data", config.data, f"has {units} units; a calibration is of one")
        records = list(dataset.records(np.arange(len(dataset))))
        return *_means(records), dataset.label("session"), str(dataset.path)
    assert config.log is not None
    return *_means(list(logs.read(config.log, north=False))), None, config.log.name


def _means(records: list[Record]) -> tuple[np.ndarray, np.ndarray, float]:
    for record in records:
        if record.heading_reference is None:
            raise InputError(
                record.name, "(unknown)", "", "has no heading: give labelled recordings"
            )
    heading = np.array([r.heading_reference for r in records], dtype=float)
    rates = np.stack([r.gyro.mean(axis=0) for r in records])
    return rates, heading, records[0].latitude


def report(c: Calibration, name: str) -> str:
    """What was found, as a person reads it; deg/h and degrees."""
    dph = DEG / HOUR
    lines = [f"{name}: {c.recordings} recordings of one unit"]
    for axis, label in enumerate(("forward", "right", "down")):
        bias, sigma, run = (v[axis] / dph for v in (c.bias, c.bias_sigma, c.run_sigma))
        between = ""
        if c.session_sigma is not None:
            between = f"between sessions {c.session_sigma[axis] / dph:.2f}, "
        lines.append(
            f"  bias {label:8s} unit {bias:+.2f} +- {sigma:.2f} deg/h, {between}run to run "
            f"{run:.2f} deg/h"
        )
    for axis, label in enumerate(("forward", "right")):
        scale, cross = c.matrix[axis, axis], 1e3 * c.matrix[axis, 1 - axis]
        sigma, cross_sigma = c.matrix_sigma[axis, axis], 1e3 * c.matrix_sigma[axis, 1 - axis]
        lines.append(
            f"  {label:13s} scale {scale:+.2%} +- {sigma:.2%}, misalignment "
            f"{cross:+.1f} +- {cross_sigma:.1f} mrad"
        )
    lines += [
        f"  across north {c.across_rms / dph:.2f} deg/h RMS: that turns the heading",
        f"  along it mean {c.along_mean / dph:+.2f}, spread {c.along_sigma / dph:.2f} deg/h: that "
        "changes the rate's size only",
        f"  heading RMSE of the plain mean {c.heading_rmse / DEG:.2f} deg",
        f"  that bias taken out: {_verdict(c.heading_rmse_without_bias, c)}",
        f"  bias, scale and misalignment taken out: {_verdict(c.heading_rmse_without_all, c)}",
        "  (on the recordings it was fitted to: on new ones it can only be worse)",
    ]
    return "\n".join(lines)


def _verdict(rmse: float, c: Calibration) -> str:
    if rmse > c.heading_rmse:
        said = "worse: it is no constant of this unit, however significant it looks"
    else:
        said = "better"
    return f"{rmse / DEG:.2f} deg, {said}"


if __name__ == "__main__":
    run_main(main, CalibrateConfig, "calibrate")
