"""Is any log read right, whatever its format, and what does a day's log cost?

    make study-logs

One recording in every format and dialect that is read must be the same, and so must its fit
(`logs_formats`); a day at 200 Hz goes through `look` and `fit` (`logs_day`); what is fitted goes
out to other tools (the study of the exports, repeated here).

And is the log doctor right, and does it ask where it cannot know? Logs as people have them
(tests/any_logs.py): any separator, header, unit, frame, rate and clock. The doctor is told the
latitude and nothing else. It may describe a log rightly, or ask; what it says without asking and is
not so is wrong in silence. Of those that anybody could tell from the file (a rate is stated; a unit
too, or Earth's rate is seen), the share is told that it describes without being asked anything.
"""

import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import exports
import logs_day
import logs_formats
from any_logs import judged, make
from common import Report, cases
from tqdm import tqdm

CASES = cases("logs")


def doctor(report: Report, home: Path) -> None:
    """The doctor on logs at random."""
    counts: dict[bool, Counter[str]] = {True: Counter(), False: Counter()}
    asked: Counter[str] = Counter()
    started = time.process_time()
    for number in tqdm(range(CASES["files"]), "logs", disable=not sys.stderr.isatty()):
        made = make(home, number, CASES["seed"])
        verdict, look = judged(made)
        decidable = bool(made.is_decidable)
        counts[decidable][verdict] += 1
        if verdict == "wrong" or (decidable and verdict != "right"):
            keys = ", ".join(guess.key for guess in look.asks)
            asked.update(guess.key for guess in look.asks)
            what = f"{made.path.name}, {made.frame}, {made.options}, bias "
            what += f"{made.bias_deg_per_h:.3g} deg/h, {made.latitude:.0f} deg; {keys}"
            report.line(f"{verdict}: {what}")
        made.path.unlink()
    seconds = time.process_time() - started
    for decidable, own in counts.items():
        what = "that anybody could tell" if decidable else "that nobody could tell"
        shown = ", ".join(f"{verdict} {count}" for verdict, count in sorted(own.items()))
        report.line(f"{own.total()} {what}: {shown}")
    shown = ", ".join(f"{key} {count}" for key, count in asked.most_common())
    report.line(f"asked of the first: {shown}")
    of_these = max(counts[True].total(), 1)
    report.summary |= {
        "doctor_files": CASES["files"],
        "doctor_decidable": counts[True].total(),
        "doctor_right_percent": 100 * counts[True]["right"] / of_these,
        "doctor_silent_wrong": counts[True]["wrong"] + counts[False]["wrong"],
        "doctor_cpu_s_a_file": seconds / CASES["files"],
    }


if __name__ == "__main__":
    with Report("studies/logs") as study, tempfile.TemporaryDirectory() as temporary:
        place = Path(temporary)
        if "formats" in CASES["parts"]:
            logs_formats.formats(study, place, CASES["recording"])
        if "doctor" in CASES["parts"]:
            doctor(study, place)
        if "day" in CASES["parts"]:
            logs_day.day(study, place, CASES["day"])
        if "exports" in CASES["parts"]:
            exports.run(study)
