"""The state-space model of a Gaussian process's interval means.

    x[k+1] = A x[k] + u[k],    y[k] = C x[k] + v[k],    cov(u, v) = [[Q, S], [S', R]],

y the means over consecutive intervals and x the process's state at an interval's start. It is all
that `lbgc.sensor.gaussian` needs to know of a term.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg


@dataclass(frozen=True, eq=False)
class MeansModel:
    """A state-space model of interval means, as in the module's equation: A (p, p), C (p,), Q
    (p, p), S (p,), R, and P0 (p, p), the covariance of the state at the recording's start, whose
    mean is zero."""

    A: np.ndarray
    C: np.ndarray
    Q: np.ndarray
    S: np.ndarray
    R: float
    P0: np.ndarray


def sde_means_model(
    F: np.ndarray, diffusion: np.ndarray, output: np.ndarray, P0: np.ndarray, interval: float
) -> MeansModel:
    """The model of the means over `interval` (s) of w = output' x, where x obeys the stochastic
    differential equation dx = F x dt + white noise of intensity `diffusion`.

    The running integral of w is one more state. The joint covariance of state and integral over h
    is the integral of e^(Fs) D e^(F's), which one matrix exponential gives without cancellation
    (Van Loan 1978, IEEE Trans. Automatic Control 23). It is taken over a stretch shorter than the
    process's own times, and the model is then doubled, which is exact too and does not overflow.
    """
    p = len(F)
    doublings = max(0, int(np.ceil(np.log2(np.abs(F).sum(axis=1).max() * interval))))
    stretch = interval / 2**doublings
    drift, D = np.zeros((p + 1, p + 1)), np.zeros((p + 1, p + 1))
    drift[:p, :p], drift[p, :p], D[:p, :p] = F, output, diffusion
    size = p + 1
    pair = np.block([[-drift, D], [np.zeros((size, size)), drift.T]]) * stretch
    exponential = scipy.linalg.expm(pair)
    transition = exponential[size:, size:].T
    joint = transition @ exponential[:size, size:]
    model = MeansModel(
        A=transition[:p, :p],
        C=transition[p, :p] / stretch,
        Q=joint[:p, :p],
        S=joint[:p, p] / stretch,
        R=float(joint[p, p]) / stretch**2,
        P0=P0,
    )
    for _ in range(doublings):
        model = _doubled(model)
    return model


def _doubled(m: MeansModel) -> MeansModel:
    """The model of means over twice the interval: y = (y1 + y2)/2."""
    return MeansModel(
        A=m.A @ m.A,
        C=(m.C + m.C @ m.A) / 2,
        Q=m.A @ m.Q @ m.A.T + m.Q,
        S=(m.A @ m.S + m.A @ m.Q @ m.C + m.S) / 2,
        R=float(2 * m.R + m.C @ m.Q @ m.C + 2 * m.C @ m.S) / 4,
        P0=m.P0,
    )
