"""The spread between units is recovered, with intervals that hold for few of them."""

import json

import numpy as np
import pytest

from lbgc.report.fitted import of_axes
from lbgc.sensor import gaussian
from lbgc.sensor.fitting import noise_fit, shapes
from lbgc.sensor.fitting.ordinates import ordinates
from lbgc.sensor.fitting.population import population
from lbgc.sensor.fitting.profile import FittedParameter
from lbgc.sensor.noise import Flicker, RandomWalk, White


def estimate(y: float, s: float) -> FittedParameter:
    """An estimate e^y whose logarithm errs by s."""
    return FittedParameter(*np.exp(y + s * np.array([0, -1.96, 1.96, 1.645])).tolist())


def drawn(rng, units, sigma, errors=(0.05, 0.2)):
    """Estimates of units whose median coefficient is e."""
    s = rng.uniform(*errors, units)
    y = 1.0 + np.hypot(sigma, s) * rng.standard_normal(units)
    return [estimate(*pair) for pair in zip(y, s, strict=True)]


@pytest.mark.parametrize("units", [3, 6, 20])
@pytest.mark.parametrize("sigma", [0.05, 0.3])
def test_intervals_hold_for_few_units(units, sigma, rng):
    """800 populations: 95% within 4.5 standard errors of a binomial; the mean's may hold more."""
    told = [population(drawn(rng, units, sigma)) for _ in range(800)]
    spread = np.mean([p.spread.low <= sigma <= p.spread.high for p in told])
    median = np.mean([p.median.low <= np.e <= p.median.high for p in told])
    error = 4.5 * np.sqrt(0.95 * 0.05 / 800)
    assert abs(spread - 0.95) < error
    assert median > 0.95 - error


def test_units_that_are_alike_are_said_to_be(rng):
    """With no spread at all: a limit in about 95 of 100, and p-values evenly spread."""
    told = [population(drawn(rng, 6, 0.0)) for _ in range(400)]
    assert abs(np.mean([p.spread.is_limit for p in told]) - 0.95) < 4.5 * np.sqrt(0.0475 / 400)
    below = np.mean([p.p_alike < 0.5 for p in told])
    assert abs(below - 0.5) < 4.5 * np.sqrt(0.25 / 400)


def test_a_unit_with_only_a_limit_is_not_left_out(rng):
    found = drawn(rng, 4, 0.3)
    assert population([*found, FittedParameter(0.1, 0.0, 1.0, 0.9)]) is None
    with pytest.raises(ValueError, match="2 units"):
        population(found[:2])


def test_a_simulated_population_of_units_is_recovered(cli, tmp_path, rng):
    """Ten units, each with an hour at 10 Hz of noise of its own size: N 10%, B 25%, K 15% between
    units. Of three spreads and three medians on each of two axes, at most two intervals miss (three
    of twelve: a chance of one in fifty)."""
    spread = {"N": 0.10, "B": 0.25, "K": 0.15}
    median = {"N": 1e-5, "B": 1e-5, "K": 1e-6}
    for k in range(10):
        fits = []
        for _ in range(2):
            n, b, w = (median[c] * np.exp(spread[c] * rng.standard_normal()) for c in "NBK")
            terms = (White(n), Flicker(b), RandomWalk(w))
            y = gaussian.sample(terms, rng, (1, 72_000), 0.1)[0]
            fits.append(noise_fit.fit(ordinates(y, 0.1), shapes.core()))
        (tmp_path / f"unit{k}").mkdir()
        content = of_axes({"gyro": [*fits, fits[0]]})
        (tmp_path / f"unit{k}" / "fit.json").write_text(json.dumps(content))
    done = cli("lbgc.fit", f"units=[{','.join(f'unit{k}' for k in range(10))}]")
    assert done.code == 0, done.err
    assert "10 units; a median unit, and the spread between units" in done.out
    told = json.loads((tmp_path / done.last_line / "population.json").read_text())
    misses = 0
    for axis in told["gyro"][:2]:
        for c in "NBK":
            assert axis[c] is not None
            s, m = axis[c]["spread"], axis[c]["median"]
            misses += not s["low"] <= spread[c] <= s["high"]
            misses += not m["low"] <= median[c] <= m["high"]
    assert misses <= 2


@pytest.mark.parametrize(
    ("units", "says"),
    [
        ("[a,b]", "must be 3 directories of fits or more"),
        ("[a,b,a]", "must be 3 directories of fits or more"),
        ("[a,b,c]", "units = c: has the same fit as another unit"),
        ("[a,b,none]", "units = none: holds no fit.json of a finished fit"),
        ("[a,b,odd]", "units = odd: holds no fit.json of a finished fit"),
    ],
)
def test_units_that_are_none_are_refused(cli, tmp_path, units, says):
    one = {"value": 1.0, "low": 0.9, "high": 1.1, "upper": 1.05}
    for name, value in (("a", 1.0), ("b", 0.95), ("c", 0.95)):
        (tmp_path / name).mkdir()
        axis = {"estimates": {"N": one | {"value": value}}}
        (tmp_path / name / "fit.json").write_text(json.dumps({"gyro": [axis] * 3}))
    (tmp_path / "odd").mkdir()
    (tmp_path / "odd" / "fit.json").write_text('{"gyro": [{"estimates": {"N": [1, 2]}}]}')
    done = cli("lbgc.fit", f"units={units}")
    assert (done.code, says in done.err) == (2, True), done.err
