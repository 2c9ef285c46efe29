"""The findings of a log's checks, each of which becomes a refusal or a note in the results."""

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
    "turned",
    "force",
    "unit",
    "bias",
    "frames",
    "vertical",
    "forward",
    "mirrored",
    "mixed",
)
"""The names of the checks, by which a log's `accept` overrides them."""


@dataclass(frozen=True)
class Finding:
    """A fault that one check found in one recording."""

    check: str
    """Name of the check, one of CHECKS"""
    name: str
    """The parameter that it is about, such as log.axes"""
    value: Any
    """The parameter's value"""
    unit: str
    """The value's unit"""
    says: str
    """What is wrong, and what would be right: a clause that continues after the value"""
    refuses: bool = True
    """Whether the recording is refused; otherwise the finding is only noted"""

    def __post_init__(self) -> None:
        assert self.check in CHECKS, self.check

    def settled(self, accepted: Collection[str]) -> str:
        """The note that the finding becomes. Raises InputError where it refuses the recording and
        its check is not among those accepted."""
        if self.refuses and self.check not in accepted:
            how = (
                f"{self.says} (check {self.check}; log.accept=[{self.check}] reads it all the same)"
            )
            raise InputError(self.name, self.value, self.unit, how)
        about = f"{self.check}: {self.says}"
        return f"{about} (accepted)" if self.refuses else about
