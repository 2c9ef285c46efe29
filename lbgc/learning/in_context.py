"""The in-context network: trained once on a population of units, it answers for a unit that it has
never seen from that unit's few labelled recordings, its context, and needs no training by its user.

It corrects the best linear estimate (lbgc.estimators.populations). Where a population is a mixture
of Gaussian laws, the answer by each of them is linear in an axis's data, and the data choose among
the laws by what does not depend on their signs. The network has the same two halves: weights that
make sums over the context, linear in its figures, and a code of the squares of such sums that says
how they are added. So it takes the recordings of a context in any order and number, none included;
turned signs of an axis turn the sign of its correction; and at first it is the linear estimate.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from tqdm import tqdm

from lbgc.errors import InputError, require_positive
from lbgc.estimators.estimate import Estimate
from lbgc.estimators.populations import Population
from lbgc.frames import wrap
from lbgc.learning import loss, threads
from lbgc.learning.model import first_weights, von_mises_sigma
from lbgc.sensor import streams

_WIDER = 3.0
"""Largest change of the logarithm of the linear estimate's concentration."""
_FOURIER = 8
"""Number of waves over the range of a condition, as features of it."""


@dataclass(frozen=True)
class InContextPlan:
    """An in-context network's size, and its training."""

    hidden: int = 32
    """Size of its layers"""
    sums: int = 16
    """Number of sums over the context"""
    steps: int = 3000
    units: int = 256
    """Units in each step, all with contexts of one size"""
    most: int = 80
    """Largest context; sizes are drawn evenly in the logarithm of 1 + k"""
    learning_rate: float = 0.003
    clip: float = 1.0
    """Largest norm of the gradient"""
    seed: int = 1

    def __post_init__(self) -> None:
        for name in ("hidden", "sums", "steps", "units", "most", "learning_rate", "clip"):
            require_positive(name, getattr(self, name))


@dataclass(frozen=True, eq=False)
class Asked:
    """U queries with their contexts, as the network takes them; the linear estimate of each."""

    figures: Tensor
    """(U, k, 3, d), the context's, by their standard deviation in the population"""
    condition: Tensor
    """(U, k), from -1 to 1"""
    at: Tensor
    """(U,), the query's"""
    own: Tensor
    """(U, 3, 2 d): the query's figures less Earth's rate at the linear estimate, and those that are
    expected of its unit"""
    base: np.ndarray
    """(U,), rad, the linear estimate"""
    sigma: np.ndarray
    """(U,), rad, its posterior sigma"""


class Asking:
    """A population as the network takes it: its linear law, and the scale of its figures."""

    def __init__(self, population: Population):
        self.population, self.linear = population, population.linear()
        spread = np.mean(np.sum(self.linear.columns[0] ** 2, axis=-1), axis=0)  # (3, d)
        self.scale = np.sqrt(1 + spread + self.linear.run[0] * population.one**2)
        self.axes = torch.from_numpy(1 / self.scale[:, :1])
        """(3, 1), share of an axis's in-run noise in its first figure, 1 sigma of 1 sigma"""

    def __call__(
        self, context: np.ndarray, condition: np.ndarray, query: np.ndarray, at: np.ndarray
    ) -> Asked:
        """Queries as the network takes them. context : (U, k, 3, d), figures less Earth's rate at
        the labels; query : (U, 3, d), less Earth's vertical rate; condition, at : numbers."""
        found, told = self.linear.best_linear(self.linear.context(context, condition), query, at)
        left = query - self.population.signal(found.heading)
        own = np.concatenate([(left - told.expected) / self.scale, told.expected / self.scale], -1)
        values = self.population.conditions
        return Asked(
            _tensor(context / self.scale),
            _tensor(values[condition]),
            _tensor(values[at]),
            _tensor(own),
            found.heading,
            found.sigma,
        )


class InContextNet(nn.Module):
    """Corrections of linear estimates. figures : d, of an axis; conditions : how many there are."""

    def __init__(self, plan: InContextPlan, figures: int, conditions: int):
        super().__init__()
        self.sums, self.figures = plan.sums, figures
        self.waves = _FOURIER if conditions > 1 else 0
        given = 1 + 2 * self.waves  # of a condition
        around = 3 + given  # the context's size, the linear sigma, the axis's noise, the condition
        odd = plan.sums + 2 * figures
        self.weigh = _layers(2 * given + 2 * figures + 2, plan.hidden, plan.sums * figures)
        self.mixed = nn.Linear(odd, plan.hidden, bias=False)
        self.code = _layers(plan.hidden + around, plan.hidden, plan.hidden)
        self.add = _layers(2 * plan.hidden + around, plan.hidden, odd)
        self.widen = _layers(plan.hidden + around, plan.hidden, 1)
        for layers in (self.add, self.widen):  # at first it is the linear estimate
            for value in layers[-1].parameters():
                nn.init.zeros_(value)

    def _given(self, condition: Tensor) -> Tensor:
        """Features of conditions, (*S,): (*S, 1 + 2 waves)."""
        waves = [math.pi / 2 * (n + 1) * condition for n in range(self.waves)]
        every = [condition, *(f(w) for w in waves for f in (torch.sin, torch.cos))]
        return torch.stack(every, dim=-1)

    def forward(self, asked: Asked, axes: Tensor) -> tuple[Tensor, Tensor]:
        """Biases of the forward and right gyro that the linear estimate has not taken off, (U, 2),
        by its sigma; and the change of its concentration's logarithm, (U,)."""
        z = asked.figures  # (U, k, 3, d)
        u, k, _, d = z.shape
        here = self._given(asked.at)  # (U, c)
        noise = axes.float().expand(u, 3, 1)  # (U, 3, 1)
        size = torch.full((u, 3, 1), math.log1p(k) / 4)
        sigma = _tensor(np.log(asked.sigma))[:, None, None].expand(u, 3, 1)
        around = torch.cat([size, sigma, noise, here[:, None].expand(u, 3, -1)], dim=-1)
        if k:
            square = torch.log1p(z**2)  # (U, k, 3, d): of no sign
            both = [self._given(asked.condition), here[:, None].expand(u, k, -1)]
            wide = [own[:, :, None].expand(u, k, 3, -1) for own in both]
            every = square.mean(dim=2, keepdim=True).expand_as(square)
            beside = [own[:, None].expand(u, k, 3, 1) for own in (noise, size)]
            weights = self.weigh(torch.cat([*wide, square, every, *beside], dim=-1))
            sums = (weights.view(u, k, 3, self.sums, d) * z[..., None, :]).sum(-1).mean(1)
        else:
            sums = z.new_zeros(u, 3, self.sums)
        odd = torch.cat([sums, asked.own], dim=-1)  # (U, 3, sums + 2 d)
        even = torch.log1p(self.mixed(odd) ** 2)  # (U, 3, H)
        code = self.code(torch.cat([even, around], dim=-1))  # (U, 3, H)
        whole = code.mean(dim=1)  # (U, H)
        shared = whole[:, None].expand(u, 3, -1)
        added = self.add(torch.cat([code, shared, around], dim=-1)) * odd  # (U, 3, sums + 2 d)
        wider = self.widen(torch.cat([whole, around.mean(dim=1)], dim=-1))  # (U, 1)
        return added.sum(dim=-1)[:, :2], _WIDER * torch.tanh(wider[:, 0] / _WIDER)


def _tensor(values: np.ndarray) -> Tensor:
    """Values in single precision."""
    return torch.from_numpy(values.astype(np.float32))


def _layers(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    """Two layers without memory."""
    return nn.Sequential(nn.Linear(inputs, hidden), nn.SiLU(), nn.Linear(hidden, outputs))


def corrected(net: InContextNet, asked: Asked, axes: Tensor) -> tuple[Tensor, Tensor]:
    """The correction of each linear estimate, (U,), rad, and the logarithm of its concentration,
    (U,)."""
    off, wider = net(asked, axes)
    sigma = _tensor(asked.sigma)
    cos, sin = (_tensor(f(asked.base)) for f in (np.cos, np.sin))
    across = off[:, 0] * sin + off[:, 1] * cos
    along = off[:, 0] * cos - off[:, 1] * sin
    # A bias b beside Earth's rate turns the estimate by -(b_x sin psi + b_y cos psi)/north.
    change = torch.atan2(sigma * across, torch.clamp(1 - sigma * along, min=0.05))
    return change, wider - 2 * torch.log(sigma)


def drawn(
    asking: Asking, rng: np.random.Generator, units: int, k: int, sampled: bool = False
) -> tuple[Asked, np.ndarray]:
    """Queries of units of the population after k labelled recordings each, and their headings,
    (U,), rad."""
    of = asking.population
    figures, condition, _ = of.draw(rng, units, k + 1, sampled)
    heading = rng.uniform(-np.pi, np.pi, units)
    query = figures[:, -1] + of.signal(heading)
    return asking(figures[:, :-1], condition[:, :-1], query, condition[:, -1]), heading


def make(plan: InContextPlan, population: Population) -> InContextNet:
    """A network for this population with its first weights; the global random state is left as it
    was."""
    with first_weights(plan.seed):
        return InContextNet(plan, population.size, len(population.conditions))


@threads.limited(1)
def train(plan: InContextPlan, population: Population, every: int = 100) -> InContextNet:
    """A network trained on units of the population that are drawn anew at each step, by the
    likelihood of a von Mises density. Raises InputError where training diverges."""
    asking, net = Asking(population), make(plan, population)
    optimiser = torch.optim.Adam(net.parameters(), lr=plan.learning_rate)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, plan.learning_rate, total_steps=plan.steps, pct_start=0.1
    )
    bar = tqdm(range(1, plan.steps + 1), population.name, leave=False, unit="step")
    for step in bar:
        rng = streams.training(plan.seed, step)
        k = int((1 + plan.most) ** rng.random() + rng.random()) - 1
        asked, heading = drawn(asking, rng, plan.units, k)
        change, log_kappa = corrected(net, asked, asking.axes)
        off = _tensor(np.rad2deg(wrap(heading - asked.base)))
        value = loss.von_mises_nll(off, torch.rad2deg(change), log_kappa)
        if not math.isfinite(value.item()):
            what = f"training diverged at step {step}; take less"
            raise InputError("learning_rate", plan.learning_rate, "", what)
        optimiser.zero_grad()
        value.backward()
        nn.utils.clip_grad_norm_(net.parameters(), plan.clip)
        optimiser.step()
        schedule.step()
        if step % every == 0:
            bar.set_postfix_str(f"{value.item():.3f} nats")
    return net.eval()


@torch.inference_mode()
def answered(net: InContextNet, asked: Asked, axes: Tensor) -> Estimate:
    """The network's headings, and the sigmas that it states."""
    change, log_kappa = corrected(net, asked, axes)
    heading = wrap(asked.base + change.double().numpy())
    return Estimate(heading, von_mises_sigma(log_kappa.double()).numpy())
