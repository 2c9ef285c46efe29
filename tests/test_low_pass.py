"""The output filter on what moves."""

import numpy as np
import pytest

from lbgc.sensor.low_pass import LowPass


def test_the_filter_delays_a_ramp_by_its_group_delay_and_passes_a_constant():
    """At low frequency the delay is 2 damping/(2 pi bandwidth); a held input keeps it exactly."""
    for bandwidth, damping, dt in ((10.0, 0.7071, 0.01), (3.0, 0.4, 1 / 600), (300.0, 1.2, 0.01)):
        ramp = np.arange(4000) * dt
        delay = ramp - LowPass(bandwidth, damping).filtered(ramp, dt)
        assert delay[-1] == pytest.approx(2 * damping / (2 * np.pi * bandwidth), rel=1e-6)
        np.testing.assert_allclose(
            LowPass(bandwidth, damping).filtered(np.full(50, -9.8), dt), -9.8, rtol=1e-12
        )


def test_the_filter_passes_a_wave_as_its_gain_says():
    """A slow enough wave, so that holding it within an interval costs nothing."""
    dt, f = 1e-4, 9.0
    t = np.arange(40_000) * dt
    out = LowPass(8.0, 0.5).filtered(np.sin(2 * np.pi * f * t), dt)[20_000:]
    assert 2 * np.mean(out**2) == pytest.approx(LowPass(8.0, 0.5).gain_squared(f), rel=1e-3)
