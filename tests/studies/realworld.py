"""Is an answer ever silently wrong? Real logs' kinds, bases that lean, sensors that see no north.

    make study-realworld
    PYTHONPATH=tests:tests/studies .venv/bin/python tests/studies/realworld.py cases floor

It takes an hour and a half on two cores, half of it `clean` and `spoiled`. The second runs only the
parts named (realworld.yaml lists them all) and keeps the other parts' figures of an earlier run in
summary.json.
"""

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from common import Report, cases
from real import clean, files, fits, headings, spoiled
from real.unseen import verdicts

from lbgc.errors import require_choice

CASES = cases("realworld")
DIRECTORY = "studies/realworld"


def readme(report: Report, _: Mapping) -> None:
    """The README's commands at full size, as `make study-readme` left them."""
    path = Path("outputs/studies/readme/summary.json")
    if not path.exists():
        report.line("readme: run make study-readme first")
        return
    found = json.loads(path.read_text())
    for key in ("readme_commands", "readme_commands_failed"):
        report.summary[key] = found[key]
        report.line(f"{key}: {found[key]}")


def unseen(report: Report, config: Mapping, seed: int) -> None:
    headings.low_signal(report, config, seed)
    verdicts(report, config, seed)


def parts(c: Mapping) -> dict[str, Callable[[Report], None]]:
    seed = c["seed"]
    return {
        "cases": lambda r: files.run(r, c),
        "clean": lambda r: clean.run(r, c["clean"], seed),
        "spoiled": lambda r: spoiled.run(r, c["spoiled"], c["clean"], seed),
        "tones": lambda r: fits.tones(r, c["tones"], seed),
        "speed": lambda r: fits.speed(r, c["speed"], seed),
        "floor": lambda r: headings.floor(r, c["floor"], seed),
        "leaning": lambda r: headings.leaning(r, c["leaning"], seed),
        "unseen": lambda r: unseen(r, c["unseen"], seed),
        "calibrate": lambda r: headings.calibrate(r, c["calibrate"]),
        "presets": lambda r: headings.presets(r, c),
        "real": lambda r: fits.real(r, c["real"]),
        "readme": lambda r: readme(r, c),
    }


def main(names: Sequence[str]) -> None:
    every = parts(CASES)
    before = Path("outputs") / DIRECTORY / "summary.json"
    kept = json.loads(before.read_text()) if before.exists() and len(names) < len(every) else {}
    with Report(DIRECTORY) as report:
        report.directory = report.directory.resolve()
        report.summary |= kept
        for name in names:
            report.line(f"== {name}")
            every[name](report)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        require_choice("part", name, CASES["parts"])
    main(sys.argv[1:] or CASES["parts"])
