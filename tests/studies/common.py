"""What every study and the bench share: where results go and what they say of the machine."""

import json
import os
import platform
import time
from pathlib import Path

import numpy as np

from lbgc.outputs import write_atomically


class Report:
    """Prints lines as they come; on exit writes summary.json and the lines as table.txt."""

    def __init__(self, directory: str):
        self.directory = Path("outputs") / directory
        self.summary: dict[str, object] = {}
        self._lines: list[str] = []

    def line(self, text: str = "") -> None:
        print(text, flush=True)
        self._lines.append(text)

    def __enter__(self) -> "Report":
        self.directory.mkdir(parents=True, exist_ok=True)
        self._started = time.perf_counter()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            return
        self.summary["minutes"] = round((time.perf_counter() - self._started) / 60, 2)
        self.summary["machine"] = f"{platform.machine()}, {os.cpu_count()} cores"
        write_atomically(self.directory / "table.txt", "\n".join(self._lines) + "\n")
        text = json.dumps(self.summary, indent=2, default=float)
        write_atomically(self.directory / "summary.json", text + "\n")
        print(self.directory / "summary.json")


def interval95(values: np.ndarray) -> tuple[float, float]:
    """Normal 95% interval of a mean of independent values."""
    half = 1.96 * np.std(values, ddof=1) / np.sqrt(len(values))
    return float(np.mean(values) - half), float(np.mean(values) + half)
