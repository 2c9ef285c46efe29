"""All estimators' answers to all windows, and the reasons where one refuses."""

import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from threadpoolctl import threadpool_limits

from lbgc.errors import InputError
from lbgc.estimators.estimate import Estimate
from lbgc.headings import Headings
from lbgc.metrics import Summary, heading_errors, summarise
from lbgc.outputs import as_csv


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit all arithmetic to one thread inside the `with` block, so that the processor time of an
    answer is what it takes: threads that wait for each other spend processor time too."""
    torch = sys.modules.get("torch")  # absent unless a network is evaluated
    before = torch.get_num_threads() if torch else 1
    with threadpool_limits(1):
        try:
            if torch:
                torch.set_num_threads(1)
            yield
        finally:
            if torch:
                torch.set_num_threads(before)


@dataclass(frozen=True)
class Own:
    """The facts of W windows, or poses, that belong to their answers."""

    heading: np.ndarray
    """(W,), rad, headings that errors are relative to; NaN where they are not known"""
    recording: np.ndarray
    """(W,), number of each window's recording"""
    latitude: np.ndarray
    """(W,), rad"""
    start_s: np.ndarray
    """(W,), s, each window's start in its recording"""
    heading_sigma: np.ndarray | None = None
    """(W,), rad, 1 sigma of those headings; None where they are true, or it is not known"""


@dataclass
class Answers:
    """Answers of one estimator at one window length, one array for each call of the estimator;
    angles in rad."""

    errors: list[np.ndarray] = field(default_factory=list)
    sigma: list[np.ndarray] = field(default_factory=list)
    estimate: list[np.ndarray] = field(default_factory=list)
    latitude: list[np.ndarray] = field(default_factory=list)
    heading: list[np.ndarray] = field(default_factory=list)
    start_s: list[np.ndarray] = field(default_factory=list)
    recording: list[np.ndarray] = field(default_factory=list)
    heading_sigma: list[np.ndarray] = field(default_factory=list)
    seconds: float = 0.0
    """Processor time of all answers."""
    at_least: bool = False
    """Whether sigmas are lower bounds."""

    def add(self, estimate: Estimate, own: Own, seconds: float) -> None:
        """Add the answers to some windows. seconds : processor time that they took."""
        self.errors.append(heading_errors(estimate.heading, own.heading))
        self.sigma.append(estimate.sigma)
        self.estimate.append(estimate.heading)
        self.latitude.append(own.latitude)
        self.heading.append(own.heading)
        self.start_s.append(own.start_s)
        self.recording.append(own.recording)
        none = np.zeros(len(own.heading))
        self.heading_sigma.append(none if own.heading_sigma is None else own.heading_sigma)
        self.seconds += seconds
        self.at_least |= estimate.at_least

    def all_of(self, name: str) -> np.ndarray:
        """The values of one field for all windows, (W,)."""
        return np.concatenate(getattr(self, name))

    def summary(self) -> Summary:
        """The figures of the errors of all windows."""
        names = ("errors", "latitude", "sigma", "recording")
        errors, latitude, sigma, recording = (self.all_of(name) for name in names)
        reference = self.all_of("heading_sigma")
        return summarise(errors, latitude, sigma, recording, self.seconds, self.at_least, reference)

    def headings(self, names: Sequence[str]) -> list[Headings]:
        """The estimated headings and sigmas, recording by recording. names : of all recordings, by
        number."""
        recording, start_s = self.all_of("recording"), self.all_of("start_s")
        heading = np.mod(np.rad2deg(self.all_of("estimate")), 360)
        sigma = np.rad2deg(self.all_of("sigma"))
        return [
            Headings(names[n], start_s[own], heading[own], sigma[own], self.at_least)
            for n in np.unique(recording)
            for own in [recording == n]
        ]


def _require_numbers(heading: np.ndarray) -> None:
    """Raise InputError where an answer is no number: no figure over the others stands for all."""
    bad = np.flatnonzero(~np.isfinite(heading))
    if len(bad):
        what = f"is its heading, and of {len(bad)} of {len(heading)} windows: there is no answer"
        raise InputError(f"window {bad[0]}", heading[bad[0]], "deg", what)


@dataclass
class Evaluation:
    """Every estimator's answers, and the reasons for those that are missing."""

    recordings: list[str] = field(default_factory=list)
    """Names of the recordings, by number."""
    answers: dict[tuple[str, float], Answers] = field(default_factory=dict)
    """Answers by estimator and window length."""
    refused: dict[tuple[str, float], str] = field(default_factory=dict)
    """Why there is no answer, by estimator and window length."""

    def ask(self, key: tuple[str, float], answer: Callable[[], Estimate], own: Own) -> None:
        """Ask an estimator for windows of one length and keep its answers. One that refuses windows
        is not asked again at this length, and its answers are dropped: figures over some recordings
        do not compare with figures over all. key : its name and the window length, s."""
        if key in self.refused:
            return
        started = time.process_time()
        try:
            found = answer()
            _require_numbers(found.heading)
        except InputError as error:
            self.refused[key] = str(error)
            self.answers.pop(key, None)
            return
        seconds = time.process_time() - started
        self.answers.setdefault(key, Answers()).add(found, own, seconds)

    def why_not(self) -> list[str]:
        """A line for each estimator that refused: at which window lengths, and the reason at the
        shortest. Reasons at others differ in their figures only; results.json has them all."""
        own: dict[str, dict[float, str]] = defaultdict(dict)
        for (name, window), reason in self.refused.items():
            own[name][window] = reason
        return [
            f"{name} is left out at {', '.join(f'{w:g}' for w in sorted(r))} s: {r[min(r)]}"
            for name, r in own.items()
        ]

    def as_csv(self) -> str:
        """CSV with a line for each window and estimator; angles in degrees, blank where unknown."""
        return as_csv(self._lines())

    def _lines(self) -> Iterator[tuple[object, ...]]:
        """The rows of `as_csv`, the header first."""
        names = ("heading_deg", "estimate_deg", "error_deg", "sigma_deg")
        yield "recording", "window_s", "start_s", "estimator", *names
        for (name, window), own in self.answers.items():
            kinds = ("heading", "estimate", "errors", "sigma")
            angles = [np.rad2deg(own.all_of(k)).round(6) for k in kinds]
            columns = [own.all_of("recording"), own.all_of("start_s"), *angles]
            for number, start, *degrees in zip(*(c.tolist() for c in columns), strict=True):
                recording = self.recordings[number]
                known = ["" if np.isnan(angle) else angle for angle in degrees]
                yield recording, f"{window:g}", f"{start:g}", name, *known
