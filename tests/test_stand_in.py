"""Few figures in the place of a sensor's law are as good as their module says."""

import numpy as np
import pytest
from exported import Model

from lbgc.sensor import stand_in
from lbgc.sensor.noise import Flicker, GaussMarkov
from lbgc.sensor.stand_in import Figures, Slow


def test_stand_ins_for_flicker_are_as_the_module_says():
    """In units of tau_c = N^2/F: white noise up to 0.10; a walk level with the flicker at (4
    L^2)^(1/3), (L/4)^(1/6) off at the worst; a process of T = 0.7 and 1.16 B up to 3.3."""
    N, F = 3.0, 2 * np.log(2) / np.pi
    unit = N**2 / F
    axis = Slow(N, 0.0, Flicker(1.0, 1e-4 * unit, 1e4 * unit).processes)
    dt, longest = 1e-3 * unit, 1e3 * unit
    tau = stand_in.octaves(dt, longest, 4)
    fine = np.geomspace(0.01 * unit, longest, 4000)
    ours = axis.allan_variance(fine)

    def end(figures: Figures) -> float:
        """Averaging time up to which these figures agree, in units."""
        agreed = stand_in.agrees(figures.allan_variance(fine, dt), ours)
        return float(fine[np.argmin(agreed)] / unit)

    walk, (process,) = stand_in.walking([axis], tau), stand_in.reverting([axis], tau)
    assert end(Figures(N)) == pytest.approx(0.10, abs=0.01)
    level, length = 3 * F / walk.K**2 / unit, tau[-1] / unit
    assert level == pytest.approx((4 * length**2) ** (1 / 3), rel=0.2)
    ratio = np.sqrt(walk.allan_variance(tau, dt) / axis.allan_variance(tau))
    assert ratio.max() == pytest.approx(1 / ratio.min(), rel=0.02)
    assert ratio.max() == pytest.approx((length / 4) ** (1 / 6), rel=0.1)
    short = stand_in.walking([axis], tau[tau < 0.3 * unit])
    assert end(short) > 0.29
    assert (process.T, process.sigma) == (
        pytest.approx(0.7 * unit, rel=0.1),
        pytest.approx(1.16, rel=0.02),
    )
    assert end(process) == pytest.approx(3.3, rel=0.1)


def test_the_law_of_a_process_at_the_samples_own_times():
    """Against the kicks' weights; u = dt/T on both sides of where the series takes over."""
    for T in (0.3, 2.0, 20.0, 3000.0):
        for m in (1, 2, 7, 64):
            pole = np.exp(-1 / T)
            model = Model(0.0, pole=pole, kick=np.sqrt(1 - pole**2))
            found = Figures(0.0, 0.0, 1.0, T).allan_variance(np.array(float(m)), 1.0)
            assert found == pytest.approx(model.allan_variance(m), rel=1e-6)
    far = Figures(0.0, 0.0, 1.0, 1e4).allan_variance(np.array([1e3, 1e5]), 1.0)
    np.testing.assert_allclose(
        far, GaussMarkov(1.0, 1e4).allan_variance(np.array([1e3, 1e5])), 1e-5
    )


def test_a_sensor_without_white_noise_has_a_stand_in_too():
    axis = Slow(0.0, 0.0, Flicker(1.0, 1.0, 1000.0).processes)
    tau = stand_in.octaves(0.01, 300.0, 4)
    walk, (process,) = stand_in.walking([axis], tau), stand_in.reverting([axis], tau)
    assert walk.N == process.N == 0
    assert walk.K > 0
    agreed = stand_in.agrees(process.allan_variance(tau, 0.01), axis.allan_variance(tau))
    assert agreed.sum() >= 8  # two octaves
