"""Do the README's commands run as they are typed, at full size, in their order and one directory?

    make study-readme

`make demo` and `make test` run where the project is; every other command in a directory of its own,
which holds the README's files, an hour's log and means at known headings.
"""

import tempfile
import time
from pathlib import Path

from common import Report, cases
from readme_commands import COMMANDS, furnish, lacking, run
from tqdm import tqdm

CASES = cases("readme")


def main() -> None:
    only = CASES["only"]
    commands = [c for c in COMMANDS if only is None or any(own in c for own in only)]
    failed, absent, count = [], [], 0
    with Report("studies/readme") as report, tempfile.TemporaryDirectory() as home:
        furnish(Path(home), CASES["log_rows"])
        for command in tqdm(commands, "typing", leave=False):
            missing = lacking(command)
            if missing is not None:
                absent.append(command)
                report.line(f"   left out  {command}   (no {missing} under $LBGC_REAL_LOGS)")
                continue
            started = time.perf_counter()
            done = run(command, Path(home), really=True)
            seconds = time.perf_counter() - started
            count += 1
            report.line(f"{seconds:9.1f} s  {command}")
            if done.returncode:
                failed.append(command)
                said = (done.stderr.strip() or done.stdout.strip()).splitlines() or ["nothing"]
                report.line(f"    FAILED ({done.returncode}): {said[-1]}")
        report.line(f"{count} commands, {len(failed)} failed")
        report.summary |= {
            "readme_commands": count,
            "readme_commands_failed": len(failed),
            "readme_commands_left_out": len(absent),
            "failed": failed,
        }


if __name__ == "__main__":
    main()
