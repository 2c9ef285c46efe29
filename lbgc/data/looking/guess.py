"""A guess at one key of a log's description, with its reason and its doubt."""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Guess:
    """The value of one key of `LogConfig`, as the doctor has it."""

    key: str
    """The key, such as gyro_unit"""
    value: Any
    """The value; None where nothing tells it"""
    why: str
    """What speaks for it: a clause"""
    doubt: str = ""
    """What may be otherwise, a clause; empty where the value is certain or nothing hangs on it"""
    sure: bool = True
    """Whether a result may rest on it; otherwise the user is asked for the key"""
    heading_only: bool = False
    """Whether nothing but a heading hangs on it"""

    @property
    def written(self) -> str:
        """The value as a user types it on a command line."""
        if isinstance(self.value, list | tuple):
            return "[" + ",".join(map(str, self.value)) + "]"
        return f"{self.value:g}" if isinstance(self.value, float) else str(self.value)
