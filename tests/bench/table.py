"""The bench's table: printed as it comes, and as a CSV file."""

import csv
import io
from dataclasses import dataclass

from common import Report
from timing import Against

from lbgc.outputs import write_atomically


@dataclass(frozen=True)
class Row:
    key: str
    what: str
    value: float
    goal: str
    """Of the issue, as printed"""
    met: bool
    over_limit: float | None = None
    limit: str = ""
    spread: float | None = None
    cpu: float | None = None


class Table:
    """Prints rows as they come; in the end a CSV file of them."""

    def __init__(self, report: Report):
        self._report, self._rows = report, []
        report.line(
            f"{'':52s}{'measured':>10s}  {'goal':>8s}  {'+-':>4s}  {'by cpu':>8s}  "
            "over its own limit"
        )

    def add(self, row: Row) -> None:
        spread = "" if row.spread is None else f"{row.spread:.0%}"
        cpu = "" if row.cpu is None else f"{row.cpu:.3g}"
        own = "" if row.over_limit is None else f"{row.over_limit:.2f} of {row.limit}"
        goal = row.goal + (" " if row.met else "!")
        self._report.line(
            f"{row.what:52s}{row.value:10.4g}  {goal:>8s}  {spread:>4s}  {cpu:>8s}  {own}"
        )
        self._report.summary[row.key] = float(f"{row.value:.5g}")
        if row.over_limit is not None:
            own = row.key.partition("_over_")[0].removeprefix("end_to_end_vehicle") or "vehicle"
            self.note(f"{own}_over_pinned_limit", row.over_limit)
        self._rows.append(row)

    def ratio(
        self, key: str, what: str, goal: float, found: Against, own: Against, limit: str
    ) -> None:
        """A rate over the floor's, and over its own limit's."""
        self.add(
            Row(key, what, found.ratio, f"{goal:g}", found.ratio >= goal, own.ratio, limit,
                found.spread, found.cpu)
        )  # fmt: skip

    def note(self, key: str, value: float) -> None:
        """What stands behind a row, for the summary alone."""
        self._report.summary[key] = float(f"{value:.5g}")

    def absent(self, what: str, why: str) -> None:
        self._report.line(f"{what:52s}    absent: {why}")

    def write(self) -> None:
        text = io.StringIO()
        lines = csv.writer(text)
        names = list(Row.__dataclass_fields__)
        lines.writerow(names)
        lines.writerows([getattr(row, name) for name in names] for row in self._rows)
        write_atomically(self._report.directory / "table.csv", text.getvalue())
