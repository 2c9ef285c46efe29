"""What is known of a log while it is examined."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from lbgc.data.logconfig import LogConfig
from lbgc.data.looking.guess import Guess
from lbgc.errors import InputError
from lbgc.frames import AXES, DOWN

_BESIDE = ("temperature_column", "heading_column", "plate_column", "positions", "angles_deg",
           "gap_s")  # fmt: skip
"""Keys of what is read beside the sensors."""


@dataclass
class Case:
    """What is known so far, while the file is examined."""

    said: Mapping[str, Any]
    heading: bool = True
    """Whether a heading is asked for"""
    facts: list[str] = field(default_factory=list)
    guesses: list[Guess] = field(default_factory=list)
    keys: dict[str, Any] = field(default_factory=dict)

    def note(self, guess: Guess) -> None:
        """Take a guess, unless the user said the key."""
        if guess.key in self.said:
            return
        self.guesses.append(guess)
        if guess.value is not None:
            self.keys[guess.key] = guess.value

    def trial(self) -> LogConfig:
        """The description so far, by which the sensors' columns are read as they are printed."""
        own = {key: value for key, value in self.keys.items() if value is not None}
        own |= {"latitude": 0.0, "repeats": self.said.get("repeats", "auto")}
        own |= {key: self.said.get(key, "auto") for key in ("gyro_unit", "accel_unit")}
        own |= {"axes": ["x", "y", "z"], "accel_axes": None, "plate_axis": AXES[DOWN]}
        own |= dict.fromkeys(_BESIDE)
        return LogConfig(**own)

    def ask(self, error: InputError, keys: tuple[str, ...]) -> None:
        """Ask for the key that a refusal names, or else for the first of these."""
        key = error.name.removeprefix("log.")
        key = key if key in LogConfig.__dataclass_fields__ else keys[0]
        self.guesses = [own for own in self.guesses if own.key != key]
        self.guesses.append(Guess(key, None, str(error), "which is it?", sure=False))
