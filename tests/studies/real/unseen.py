"""Whether the verdict on a sensor, window and protocol is what happens there."""

from collections.abc import Mapping

import floor_cases
import numpy as np
from common import Report, interval95
from floor_cases import Case
from helpers import ROOT
from tqdm import tqdm

from lbgc import verdict
from lbgc.data.record import Record
from lbgc.estimators.floor import floor
from lbgc.frames import wrap
from lbgc.protocol import ProtocolConfig

PROTOCOLS: Mapping[str, ProtocolConfig] = {
    "static": floor_cases.STATIC,
    "two_position": floor_cases.TWO,
}
_MEANS = 60  # in a window


def verdicts(report: Report, config: Mapping, seed: int) -> None:
    """Every preset, window and protocol: the verdict against the floor's RMSE on simulated windows.
    Where 60 degrees lie within the 95% interval of that RMSE, neither verdict is wrong."""
    presets = sorted(path.stem for path in (ROOT / "conf" / "imu").glob("*.yaml"))
    every = [
        (preset, protocol, float(window))
        for preset in presets
        for protocol in config["verdict_protocols"]
        for window in config["verdict_windows_s"]
    ]
    right = []
    for preset, protocol, window in tqdm(every, "verdicts", leave=False):
        case = Case(preset, preset, PROTOCOLS[protocol], window, max(0.1, window / _MEANS))
        imu = case.model()
        drawn = floor_cases.draw(case, imu, config["verdict_recordings"], seed)
        windows = drawn.windows
        record = Record("one", windows.gyro[0], windows.accel[0], windows.plate_angle[0],
                        windows.rate_hz, floor_cases.LATITUDE)  # fmt: skip
        (found,) = verdict.verdicts(imu, record, [window])
        squares = np.rad2deg(wrap(floor(windows, imu).heading - drawn.heading)) ** 2
        low, high = (np.sqrt(max(end, 0.0)) for end in interval95(squares))
        seen = bool(np.sqrt(squares.mean()) <= verdict.MOST_DEG)
        right.append(found.can == seen or low < verdict.MOST_DEG < high)
        report.line(
            f"{preset:18s} {protocol:13s} {window:5g} s: {'can' if found.can else 'CANNOT':6s} "
            f"floor {found.floor_deg:6.2f}, simulated {np.sqrt(squares.mean()):6.2f} "
            f"[{low:.2f}, {high:.2f}]{'' if right[-1] else '  WRONG'}"
        )
    report.summary["unseen_verdicts"] = len(right)
    report.summary["unseen_verdicts_right_percent"] = 100 * float(np.mean(right))
