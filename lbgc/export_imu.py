"""Write a sensor in the terms of other tools: calibration packages, filters, simulators.

python lbgc/export_imu.py imu=stim300 format=[kalibr,gazebo] rate_hz=200
"""

from dataclasses import asdict, dataclass, field
from pathlib import Path

from lbgc.commands import run_main
from lbgc.errors import require
from lbgc.exports import FORMATS, require_formats, written
from lbgc.exports.subject import LONGEST_S, Subject
from lbgc.outputs import fingerprint, mark_latest, task_directory, write_atomically
from lbgc.sensor.datasheet import ImuConfig


@dataclass(frozen=True)
class ExportImuConfig:
    """The keys of `conf/export_imu.yaml`."""

    format: list[str] = field(default_factory=lambda: list(FORMATS))
    """The tools to write for."""
    rate_hz: float = 200.0
    """Samples a second: figures of one sample, and the noise of counts, depend on it."""
    longest_s: float = LONGEST_S
    """Averaging time up to which stand-ins are chosen and compared."""
    imu: ImuConfig = field(default_factory=ImuConfig)

    def __post_init__(self) -> None:
        require(len(self.format) > 0, "format", self.format, list(FORMATS))
        require_formats("format", self.format)
        _ = self.subject

    @property
    def subject(self) -> Subject:
        """The sensor as it is written. Raises InputError where rate and times do not match."""
        return Subject(self.imu, self.rate_hz, self.longest_s)


def main(config: ExportImuConfig) -> Path:
    """Write a file for each tool, say what it holds and what is lost, and return the directory."""
    directory = task_directory("export_imu", fingerprint(asdict(config)))
    for name, text in written(config.subject, config.format).items():
        write_atomically(directory / name, text)
        print(f"{name}: {len([1 for line in text.splitlines() if 'lost: ' in line])} keys are lost")
    mark_latest(directory)
    return directory


if __name__ == "__main__":
    run_main(main, ExportImuConfig, "export_imu")
