"""What the checks of a log find, and what becomes of it: a refusal, or a note in its results."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from lbgc.errors import InputError

CHECKS = (
    "stuck",
    "outliers",
    "rail",
    "pasted",
    "counts",
    "held",
    "moved",
    "force",
    "unit",
    "bias",
    "frames",
    "vertical",
    "forward",
    "mirrored",
)
"""The names by which a log's `accept` overrides them."""


@dataclass(frozen=True)
class Finding:
    """What one check says of one recording."""

    check: str
    """Name of the check, one of CHECKS."""
    name: str
    """The parameter that it is about, such as log.axes."""
    value: Any
    unit: str
    says: str
    """What is wrong, and what would make sense: a clause that reads on behind the value."""
    refuses: bool = True
    """Whether no answer may be given; else it is noted."""

    def __post_init__(self) -> None:
        assert self.check in CHECKS, self.check

    def settled(self, accepted: Collection[str]) -> str:
        """The note that it becomes. Raises InputError where it refuses and is not accepted."""
        if self.refuses and self.check not in accepted:
            how = (
                f"{self.says} (check {self.check}; log.accept=[{self.check}] reads it all the same)"
            )
            raise InputError(self.name, self.value, self.unit, how)
        about = f"{self.check}: {self.says}"
        return f"{about} (accepted)" if self.refuses else about
