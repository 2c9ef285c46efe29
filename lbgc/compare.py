"""Compare a sweep's training runs in one table: size, error with its spread over seeds, latency.

python lbgc/compare.py runs=outputs/train
"""

from dataclasses import dataclass
from pathlib import Path

from lbgc.commands import run_main
from lbgc.errors import require
from lbgc.learning import comparison


@dataclass(frozen=True)
class CompareConfig:
    """The keys of `conf/compare.yaml`."""

    runs: str = "outputs/train"
    """Directory of training runs."""

    def __post_init__(self) -> None:
        require(bool(self.runs), "runs", self.runs, "must be a directory of training runs")


def main(config: CompareConfig) -> Path:
    """Print the table, write it as CSV, and return its path."""
    return comparison.tabulated(comparison.runs(Path(config.runs)))


if __name__ == "__main__":
    run_main(main, CompareConfig, "compare")
