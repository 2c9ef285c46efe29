"""The in-context network: what it cannot get wrong by its form, and that it learns."""

from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from helpers import default_config

from lbgc.errors import InputError
from lbgc.estimators import populations
from lbgc.estimators.block_means import Site
from lbgc.estimators.populations import Bench
from lbgc.frames import wrap
from lbgc.learning import in_context
from lbgc.learning.in_context import Asking, InContextNet, InContextPlan, answered
from lbgc.metrics import rmse_ratio
from lbgc.units import DEG, HOUR

DPH = DEG / HOUR
BENCH = Bench(default_config("imu=sdc500").imu.model(600.0), Site.at(0.57), 6, 10.0)
KINDS = populations.good_and_bad(BENCH, 0.3 * DPH, 3 * DPH, 0.2, 0.4 * DPH)
STEP = populations.steps_in_temperature(
    BENCH, 0.5 * DPH, 1.5 * DPH, 0.3 * DPH, 0.1, nodes=5, temperatures=7
)
PLAN = InContextPlan(hidden=8, sums=4, steps=60, units=64, most=6, seed=2)


def awake(law: populations.Population) -> InContextNet:
    """A network none of whose weights are zero."""
    net = in_context.make(PLAN, law)
    with torch.no_grad():
        for n, value in enumerate(net.parameters()):
            value += 0.1 * torch.randn(value.shape, generator=torch.Generator().manual_seed(n))
    return net.eval()


def queries(law: populations.Population, units: int, k: int, seed: int = 4):
    rng = np.random.default_rng(seed)
    figures, condition, _ = law.draw(rng, units, k + 1)
    heading = rng.uniform(-np.pi, np.pi, units)
    query = figures[:, -1] + law.signal(heading)
    return figures[:, :-1], condition[:, :-1], query, condition[:, -1], heading


@pytest.mark.parametrize("k", [0, 1, 5])
@pytest.mark.parametrize("law", [KINDS, STEP], ids=lambda law: law.name)
def test_at_first_it_is_the_linear_estimate(law, k):
    asking = Asking(law)
    *given, _ = queries(law, 20, k)
    asked = asking(*given)
    found = answered(in_context.make(PLAN, law), asked, asking.axes)
    np.testing.assert_allclose(wrap(found.heading - asked.base), 0, atol=1e-7)
    # The circle bends a von Mises density of that concentration; where it is narrow they agree.
    narrow = asked.sigma < 0.1
    np.testing.assert_allclose(found.sigma[narrow], asked.sigma[narrow], rtol=0.01)


def test_the_order_of_a_context_says_nothing():
    asking, net = Asking(STEP), awake(STEP)
    figures, condition, query, at, _ = queries(STEP, 20, 6)
    turned = np.random.default_rng(1).permutation(6)
    one, two = (
        answered(net, asking(figures[:, own], condition[:, own], query, at), asking.axes)
        for own in (np.arange(6), turned)
    )
    np.testing.assert_allclose(one.heading, two.heading, atol=1e-5)
    np.testing.assert_allclose(one.sigma, two.sigma, rtol=1e-4)
    plain = asking(figures, condition, query, at)
    assert np.abs(wrap(one.heading - plain.base)).max() > 1e-3, "a network that does something"


def test_a_mirrored_unit_is_answered_by_the_mirrored_heading():
    """All of the right gyro's figures turned in sign: the heading's sine turns with them."""
    asking, net = Asking(STEP), awake(STEP)
    figures, condition, query, at, _ = queries(STEP, 20, 3)
    sign = np.array([1.0, -1.0, 1.0])[:, None]
    one = answered(net, asking(figures, condition, query, at), asking.axes)
    two = answered(net, asking(figures * sign, condition, query * sign, at), asking.axes)
    np.testing.assert_allclose(wrap(one.heading + two.heading), 0, atol=1e-5)


def test_each_unit_is_answered_from_its_own_recordings_alone():
    asking, net = Asking(KINDS), awake(KINDS)
    figures, condition, query, at, _ = queries(KINDS, 20, 3)
    every = answered(net, asking(figures, condition, query, at), asking.axes)
    alone = answered(net, asking(figures[7:8], condition[7:8], query[7:8], at[7:8]), asking.axes)
    assert every.heading[7] == pytest.approx(alone.heading[0], abs=1e-6)


def test_it_learns_what_no_linear_estimate_can():
    """After one recording, on 4000 units that it has never seen: paired, below the best linear
    estimate; and its sigma is roughly what its errors are."""
    plan = replace(PLAN, steps=250, hidden=16, sums=8, units=128, most=3, learning_rate=0.01)
    net, asking = in_context.train(plan, KINDS), Asking(KINDS)
    *given, heading = queries(KINDS, 4000, 1, seed=90)
    asked = asking(*given)
    found = answered(net, asked, asking.axes)
    errors, before = (wrap(own - heading) for own in (found.heading, asked.base))
    assert rmse_ratio(errors, before, np.arange(4000)).high < 1
    assert 0.6 < np.mean((errors / found.sigma) ** 2) < 1.7


def test_one_plan_one_set_of_weights_and_every_field_matters():
    def weights(plan: InContextPlan) -> bytes:
        net = in_context.train(plan, KINDS)
        return b"".join(v.detach().numpy().tobytes() for v in net.state_dict().values())

    base = replace(PLAN, steps=4)
    usual = weights(base)
    assert weights(base) == usual
    changes = {"hidden": 6, "sums": 3, "steps": 5, "units": 32, "most": 40,
               "learning_rate": 0.01, "clip": 1e-9, "seed": 3}  # fmt: skip
    assert set(changes) == {f.name for f in fields(InContextPlan)}
    for name, value in changes.items():
        assert weights(replace(base, **{name: value})) != usual, name


def test_a_training_that_diverges_says_so():
    with pytest.raises(InputError, match="learning_rate = 1e\\+38: training diverged at step"):
        in_context.train(replace(PLAN, learning_rate=1e38), KINDS)
    with pytest.raises(InputError, match="sums = 0: must be greater than zero"):
        replace(PLAN, sums=0)
