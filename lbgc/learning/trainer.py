"""The training loop: one window length and one batch a step; early stopping; resuming."""

import copy
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor, nn
from tqdm import tqdm

from lbgc.data.windows import Labelled
from lbgc.errors import InputError, reading
from lbgc.learning import checkpoint, loss, threads
from lbgc.learning.ahead import Batch, Batches, ahead
from lbgc.learning.batches import Examples, Sensed, every
from lbgc.learning.model import RECURRENT, ModelConfig, make
from lbgc.sensor import streams

SCHEDULES = ("onecycle", "cosine")
_SCALES = (1e-5, 0.5)  # rad, least and most
_MOST_FOR_SCALE = 1000  # windows
_KNOWN = 0.05
"""1 sigma of the prior on the error of the logarithm of a trained network's sigma."""


@dataclass(frozen=True)
class TrainingPlan:
    """A training's settings."""

    model: ModelConfig
    windows_steps: dict[float, int]
    """Lengths of the windows, s, and the network's steps in each."""
    steps: int
    batch: int
    learning_rate: float
    schedule: str
    clip: float
    validate_every: int
    patience: int | None
    """Number of looks at the validation split without a better score, after which training ends."""
    checkpoint_every: int
    seed: int
    warm_up: int
    """Number of first steps in which a network that states a sigma learns headings alone."""
    reference_sigma: float
    """rad, 1 sigma of the error of the reference headings; it is no part of a stated sigma."""
    tempering: int
    """Number of fresh windows of each length by which a stated sigma is calibrated at the end."""
    threads: int | None = None
    """Threads of the network's arithmetic; None: by the network's size."""
    echo: int = 1
    """Number of steps in a row that take the same batch."""


class Trainer:
    """One network's training. `net` holds its weights, `best` the best weights so far, `history`
    the looks at the validation split."""

    def __init__(
        self,
        plan: TrainingPlan,
        source: Examples,
        sensed: Sensed,
        stored: Labelled,
        validation: Labelled,
    ):
        """source : of the training's batches; stored, validation : whole recordings of the training
        and of the validation split."""
        self.plan, self.source, self.sensed = plan, source, sensed
        self.device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        self.net = make(plan.model, plan.seed)
        if plan.model.base is not None and not plan.model.sways:
            self.net.scale.fill_(self._scale(stored))
        self.net.to(self.device)
        self.optimiser = torch.optim.Adam(self.net.parameters(), lr=plan.learning_rate)
        self.schedule = _schedule(plan, self.optimiser)
        block = round(validation.windows.rate_hz / sensed.rate_hz)
        self.validation = [
            (window, *self._there(sensed.examples(every(validation, steps * block))))
            for window, steps in plan.windows_steps.items()
        ]
        self.threads = plan.threads or threads.wanted(plan.model, plan.batch)
        self.step = 0
        self.seconds = 0.0  # of the steps that are kept: those that a kill loses do not count
        self.smoothed: float | None = None
        self.history: list[dict[str, float]] = []
        self.best: dict[str, Tensor] = copy.deepcopy(self.net.state_dict())
        self._batches = Batches(source, plan.seed, plan.batch, plan.windows_steps, plan.echo)
        self._ahead: Iterator[Batch] | None = None

    def run(self, file: Path, on_look: Callable[[list[dict[str, float]]], None]) -> None:
        """Train to the end, from the checkpoint if there is one at `file`.

        on_look : called with the history after each look at the validation split.
        """
        if file.exists():
            self._restore(file)
        started = time.perf_counter() - self.seconds
        progress = tqdm(total=self.plan.steps, initial=self.step, desc="training", unit="step")
        with progress as bar, self.drawing_ahead():
            while not self._finished():
                self.step += 1
                value = self._finite(self._train())
                before = value if self.smoothed is None else self.smoothed
                self.smoothed = 0.98 * before + 0.02 * value
                if self.step % self.plan.validate_every == 0 or self.step == self.plan.steps:
                    bar.set_postfix_str(self._look())
                    on_look(self.history)
                self.seconds = time.perf_counter() - started
                if self.step % self.plan.checkpoint_every == 0:
                    self._keep(file)
                bar.update()
        if self.plan.model.output == "vonmises":
            self._temper()

    def _finite(self, value: float) -> float:
        """The loss or score as it is. Raises InputError where it is not finite: training cannot
        recover from that."""
        if not math.isfinite(value):
            what = (
                f"training diverged at step {self.step}: the loss is no number any more; take less"
            )
            raise InputError("learning_rate", self.plan.learning_rate, "", what)
        return value

    def _finished(self) -> bool:
        """Whether all steps are done, or patience has run out."""
        if self.step >= self.plan.steps:
            return True
        if self.plan.patience is None or not self.history:
            return False
        since = len(self.history) - 1 - self._best_look()
        return since >= self.plan.patience

    def _best_look(self) -> int:
        """Number of the look with the best score."""
        return int(np.argmin([row["score"] for row in self.history]))

    def _look(self) -> str:
        """Validate, keep the weights if they are the best so far, and report both in words."""
        row = self._validate()
        self._finite(row["score"] + row["all"])
        self.history.append({"step": self.step, "train_loss": self.smoothed or 0.0, **row})
        if self._best_look() == len(self.history) - 1:
            self.best = copy.deepcopy(self.net.state_dict())
        best = self.history[self._best_look()]["all"]
        return f"validation {row['all']:.3g} deg, best {best:.3g}"

    @contextmanager
    def drawing_ahead(self) -> Iterator[None]:
        """Inside the `with` block the following steps' batches are drawn ahead of time."""
        steps = range(self.step + 1, self.plan.steps + 1)
        by_thread = self.plan.model.cell in RECURRENT
        try:
            with (
                threads.limited(self.threads),
                ahead(self._batches, steps, by_thread) as self._ahead,
            ):
                yield
        finally:
            self._ahead = None

    def batch(self) -> tuple[Tensor, Tensor]:
        """This step's features, (W, T, C), and targets, (W,), degrees, on the network's device."""
        return self._there(self._batches[self.step] if self._ahead is None else next(self._ahead))

    def _train(self) -> float:
        """Take one training step; its loss."""
        x, reference_deg = self.batch()
        self.net.train()
        value = self._loss(self.net(x), reference_deg)
        self.optimiser.zero_grad()
        value.backward()
        nn.utils.clip_grad_norm_(self.net.parameters(), self.plan.clip)
        self.optimiser.step()
        self.schedule.step()
        return float(value.detach())

    def _there(self, batch: Batch) -> tuple[Tensor, Tensor]:
        """A batch's features, and its targets in degrees, on the network's device."""
        x, off = batch
        target = torch.from_numpy(np.rad2deg(off).astype(np.float32))
        return torch.from_numpy(x).to(self.device), target.to(self.device)

    def _scale(self, stored: Labelled) -> float:
        """RMS error of the base, rad, on up to 1000 of the longest windows of the training split,
        within [1e-5, 0.5]."""
        windows = every(stored, max(self.plan.windows_steps.values()))
        pick = np.arange(len(windows))[:_MOST_FOR_SCALE]
        _, error = self.sensed.examples(windows.rows(pick))
        return float(np.clip(np.sqrt(np.mean(error**2)), *_SCALES))

    def _loss(self, raw: Tensor, reference_deg: Tensor) -> Tensor:
        """The loss that the network's kind of output is trained by, of its raw output."""
        heading, output = self.net.heading_deg(raw), self.plan.model.output
        if output == "vonmises" and self.net.training and self.step <= self.plan.warm_up:
            return loss.vector_mse(reference_deg, raw[:, :2])
        if output == "vonmises":
            own = self.plan.reference_sigma
            return loss.von_mises_nll(reference_deg, heading, self.net.log_kappa(raw), own)
        if output == "sincos":
            return loss.vector_mse(reference_deg, raw)
        return loss.cyclic_mse(reference_deg, heading)

    @torch.inference_mode()
    def _validate(self) -> dict[str, float]:
        """RMSE in degrees against the reference, for each window length and over all of them; and
        the score that decides which weights are kept: the latter, or the mean loss where that is a
        likelihood."""
        self.net.eval()
        errors, losses = {}, []
        for window, x, truth in self.validation:
            raw = self.net(x)
            off = loss.cyclic_mse(truth, self.net.heading_deg(raw))
            errors[f"validation_{window:g}s_deg"] = float(off.sqrt())
            losses.append(float(self._loss(raw, truth)))
        all_of = float(np.sqrt(np.mean(np.square(list(errors.values())))))
        likely = self.plan.model.output == "vonmises"
        return {**errors, "all": all_of, "score": float(np.mean(losses)) if likely else all_of}

    @torch.inference_mode()
    def _temper(self) -> None:
        """Calibrate the best weights' concentration at each window length, by maximum likelihood on
        held-out windows. The change of its logarithm is linear where fresh windows can be drawn.
        Else it is a constant, by the validation split: the spread takes thousands of windows.
        """
        self.net.load_state_dict(self.best)
        self.net.eval()
        rng = streams.training(self.plan.seed, 0)  # steps begin at 1
        found: dict[int, tuple[float, float]] = {}
        for (_, x, reference_deg), steps in zip(
            self.validation, self.plan.windows_steps.values(), strict=True
        ):
            if self.source.fresh is not None:
                x, reference_deg = self._there(
                    self.source.fresh.draw(rng, self.plan.tempering, steps)
                )
            spread = self.source.fresh is not None
            found[steps] = self._likeliest(self.net(x), reference_deg, spread)
        lengths = np.array(sorted(found))
        self.net.temper(lengths, *np.array([found[n] for n in lengths]).T)
        self.best = copy.deepcopy(self.net.state_dict())

    def _likeliest(
        self, raw: Tensor, reference_deg: Tensor, with_spread: bool
    ) -> tuple[float, float]:
        """(more, wider), the most likely change of the concentration's logarithm l to
        l (1 + wider) + more.

        A network's own spread of l exceeds the true one: regression to the mean. A prior of _KNOWN
        on either effect on the logarithm of sigma keeps few windows from doing more harm than good.
        """
        heading, log_kappa = self.net.heading_deg(raw), self.net.log_kappa(raw).double()
        middle, spread = float(log_kappa.mean()), max(float(log_kappa.std(correction=0)), 1e-3)

        def change(by: np.ndarray) -> tuple[float, float]:
            """(more, wider) of a shift of the mean of l, and of a change of its spread."""
            wider = float(by[1]) / spread if with_spread else 0.0
            return float(by[0]) - wider * middle, wider

        def value(by: np.ndarray) -> float:
            """Mean negative log posterior of such a change."""
            more, wider = change(by)
            own = self.plan.reference_sigma
            likely = loss.von_mises_nll(reference_deg, heading, log_kappa * (1 + wider) + more, own)
            return float(likely) + float(np.sum((by / 2 / _KNOWN) ** 2)) / 2 / len(raw)

        free = 1 + with_spread
        around = np.concatenate([np.zeros((1, free)), 0.05 * np.eye(free)])
        options = {"initial_simplex": around, "xatol": 1e-4, "fatol": 1e-9}
        return change(minimize(value, np.zeros(free), method="Nelder-Mead", options=options).x)

    def _counters(self) -> dict[str, Any]:
        """All of a checkpoint that is no tensor."""
        return {
            "step": self.step,
            "seconds": self.seconds,
            "smoothed": self.smoothed,
            "history": self.history,
            "schedule": self.schedule.state_dict(),
            "groups": self.optimiser.state_dict()["param_groups"],
        }

    def _keep(self, file: Path) -> None:
        """Write a checkpoint."""
        moments = {
            f"{number}.{name}": value
            for number, state in self.optimiser.state_dict()["state"].items()
            for name, value in state.items()
        }
        tensors = {"net": self.net.state_dict(), "best": self.best, "optimiser": moments}
        checkpoint.write(file, tensors, self._counters())

    def _restore(self, file: Path) -> None:
        """Go on from a checkpoint. Raises InputError where it is damaged or of another training."""
        tensors, said = checkpoint.read(file)
        with reading("checkpoint", file, f"is of another training; {checkpoint.AGAIN}"):
            self._check(tensors, said)
            self.net.load_state_dict(tensors["net"])
            self.best = {name: value.to(self.device) for name, value in tensors["best"].items()}
            state: dict[int, dict[str, Tensor]] = {}
            for key, value in tensors["optimiser"].items():
                number, name = key.split(".", 1)
                state.setdefault(int(number), {})[name] = value
            self.optimiser.load_state_dict({"state": state, "param_groups": said["groups"]})
            self.schedule.load_state_dict(said["schedule"])
            self.step, self.seconds = said["step"], said["seconds"]
            self.smoothed, self.history = said["smoothed"], said["history"]

    def _check(self, tensors: dict[str, dict[str, Tensor]], said: dict[str, Any]) -> None:
        """Raise ValueError unless a checkpoint's tensors have this training's names and shapes, and
        its counters are of the right kinds."""
        single = torch.float32
        own = {n: (value.shape, value.dtype) for n, value in self.net.state_dict().items()}
        moments = {
            f"{number}.{name}": (torch.Size() if name == "step" else value.shape, single)
            for number, value in enumerate(self.net.parameters())
            for name in ("step", "exp_avg", "exp_avg_sq")
        }
        wanted = {"net": own, "best": own, "optimiser": moments}
        found = {
            g: {n: (v.shape, v.dtype) for n, v in named.items()} for g, named in tensors.items()
        }
        if found != wanted:
            raise ValueError("its tensors have other names, shapes or kinds")
        numbers = {**self._counters(), "smoothed": 0.0, "history": []}
        rows = said.get("history")
        history = isinstance(rows, list) and all(
            _alike(row, {"step": 0, "train_loss": 0.0, "all": 0.0, "score": 0.0}, more=True)
            for row in rows
        )
        if not history or not _alike(said | {"history": []}, numbers):
            raise ValueError("its counters are not what they must be")
        if not 0 < said["step"] <= self.plan.steps:
            raise ValueError(f"step {said['step']} of {self.plan.steps}")


def _alike(found: Any, own: Any, more: bool = False) -> bool:
    """Whether a value read from JSON has the keys and the kinds of values of this program's own.

    more : whether it may have other keys besides, with numbers.
    """
    if isinstance(own, dict):
        if not isinstance(found, dict) or not (set(own) <= set(found)):
            return False
        others = {key: found[key] for key in set(found) - set(own)}
        known = all(_alike(found[key], value) for key, value in own.items())
        numbers = all(_alike(value, 0.0) for value in others.values())
        return known and (not others or (more and numbers))
    if isinstance(own, list | tuple):
        same = isinstance(found, list) and len(found) == len(own)
        return same and all(map(_alike, found, own))
    if isinstance(own, bool) or own is None or isinstance(own, str):
        return type(found) is type(own)
    if isinstance(own, int):
        return type(found) is int
    return type(found) in (int, float) and math.isfinite(found)


def _schedule(
    plan: TrainingPlan, optimiser: torch.optim.Optimizer
) -> torch.optim.lr_scheduler.LRScheduler:
    """The schedule of the learning rate over a training's steps."""
    if plan.schedule == "cosine":
        return torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, plan.steps)
    return torch.optim.lr_scheduler.OneCycleLR(
        optimiser, plan.learning_rate, total_steps=plan.steps, pct_start=0.1
    )
