"""Three ways to north without a calibration, and what each costs in minutes: turn the plate, tumble
through poses, or label recordings first."""

from collections.abc import Sequence

import numpy as np
from tqdm import tqdm

from lbgc import labelling
from lbgc.errors import InputError
from lbgc.estimators.block_means import Site
from lbgc.estimators.floor import SETTLE_S, course_of, expected_floor
from lbgc.estimators.information import information
from lbgc.estimators.tumble_floor import Tumbling, expected
from lbgc.estimators.unit_posterior import Reference
from lbgc.protocol import ProtocolConfig
from lbgc.sensor.imu import ImuModel

MOST_POSES = 100
_TWO = ProtocolConfig("two_position", "indexed", angles_deg=(0.0, 180.0))
_STATIC = ProtocolConfig("static", "static")


def ways(
    imu: ImuModel,
    site: Site,
    counts: Sequence[int],
    dwell_s: float,
    handling_s: float,
    reference: Reference,
) -> list[dict[str, float]]:
    """The expected error, degrees, after a tumble through so many poses of dwell_s each, handling_s
    apart, and beside it: two positions in the same minutes, and as many rests of the same length of
    which all but one were labelled, in power-ups of their own. reference : of the labels' error."""
    rows = []
    rest = course_of(_STATIC, dwell_s)
    for count in tqdm(sorted(set(counts)), "tumbling", leave=False):
        row: dict[str, float] = {"poses": count}
        for integrated in (False, True):
            plan = Tumbling(count, dwell_s, handling_s, integrated)
            row["minutes"] = plan.seconds / 60
            closed, floor = np.rad2deg(expected(imu, plan, site.latitude, site.gravity))
            kind = "integrated" if integrated else "separate"
            row |= {f"{kind}_crlb_deg": float(closed), f"{kind}_deg": float(floor)}
        row["two_position_deg"] = float("nan")
        try:
            two = course_of(_TWO, plan.seconds, settle_s=SETTLE_S)
            floor = expected_floor(information(imu, two, site))
            row["two_position_deg"] = float(np.rad2deg(floor))
        except InputError:  # no time for the slew
            pass
        known = labelling.after(imu, rest, site, count - 1, None, reference)
        floor = expected_floor(information(known, rest, site))
        row["labelled_deg"] = float(np.rad2deg(floor))
        rows.append(row)
    return rows


def table(rows: Sequence[dict[str, float]], dwell_s: float, handling_s: float) -> str:
    """The ways as text. rows : see `ways`."""
    lines = [
        f"north without a turntable: poses of {dwell_s:g} s in any attitudes, {handling_s:g} s "
        "apart; and in the same minutes two positions, or all rests but one labelled: degrees",
        f"{'poses':>7s} {'minutes':>8s} {'separate':>9s} {'integrated':>11s} {'two_position':>13s} "
        f"{'labelled':>9s}",
    ]
    for row in rows:
        lines.append(
            f"{row['poses']:7.0f} {row['minutes']:8.1f} {row['separate_deg']:9.3f} "
            f"{row['integrated_deg']:11.3f} {row['two_position_deg']:13.3f} "
            f"{row['labelled_deg']:9.3f}"
        )
    return "\n".join(lines)
