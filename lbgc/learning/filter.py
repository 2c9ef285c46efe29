"""A network for bases that sway: a linear filter with learned weights, which adapt to the sway.

Horizontal velocity v and rate w (lbgc.learning.sway) are taken as complex numbers. Their Legendre
moments m over the window make one number,

    z = sum over k of a_k m_k(v) + b_k m_k(w),

whose angle is the heading, or the correction of a base's. An IMU turned in its mount turns v and w
alike, so z turns with it whatever the complex weights are. The weights are learned constants, plus
the output of a few layers whose inputs are figures of the window that no such turn changes. Among
these are the size of the sway that the moments do not explain, with which a sigma scales, and the
lever arm that fits the rate best.
"""

from itertools import pairwise

import torch
from torch import Tensor, nn

from lbgc.learning.sway import CONSTANTS, PER_STEP

_MOMENTS = 6
_LIVELY_MOMENTS = 4
_FIGURES = 5 + _LIVELY_MOMENTS + CONSTANTS
_LEAST = 1e-12
"""Added to mean squares and to arguments of roots, so that nothing is divided by zero."""


class Filter(nn.Module):
    """The filter as a PyTorch module: features (W, T, PER_STEP + CONSTANTS) to sine and cosine, and
    where it states a sigma the logarithm of the concentration: (W, 2 or 3)."""

    def __init__(self, hidden: int, layers: int, outputs: int, corrects: bool):
        super().__init__()
        self.corrects, self.states_sigma = corrects, outputs == 3
        sizes = [_FIGURES, *[hidden] * layers]
        self.inside = nn.ModuleList(nn.Linear(*pair) for pair in pairwise(sizes))
        self.out = nn.Linear(hidden, 4 * _MOMENTS + self.states_sigma)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)
        # Without a base the angle of z = 0 has no gradient, so weights start at random.
        first = torch.zeros(4 * _MOMENTS) if corrects else 0.1 * torch.randn(4 * _MOMENTS)
        self.weights = nn.Parameter(first)

    def forward(self, x: Tensor) -> Tensor:
        """Sine and cosine, and the concentration's logarithm if asked for, (W, 2 or 3), of features
        x, (W, T, PER_STEP + CONSTANTS)."""
        p = legendre(x.shape[1], _MOMENTS, x)  # (K, T)
        seen = x[..., :4]  # (W, T, 4): v, w
        m = torch.matmul(p / x.shape[1], seen)  # (W, K, 4)
        of_each = torch.arange(1, 2 * _MOMENTS, 2, device=x.device, dtype=x.dtype)
        rest = seen - torch.matmul(p.T, of_each[:, None] * m)  # (W, T, 4): not explained by moments
        figures, size = self._figures(x, rest, p)  # (W, F), (W,)
        h = figures
        for layer in self.inside:
            h = torch.tanh(layer(h))  # (W, H)
        out = self.out(h)  # (W, 4 K [+ 1])
        re_v, im_v, re_w, im_w = (self.weights + out[:, : 4 * _MOMENTS]).split(_MOMENTS, dim=1)
        vx, vy, wx, wy = m.unbind(dim=2)  # (W, K) each
        re = (re_v * vx - im_v * vy + re_w * wx - im_w * wy).sum(dim=1)  # (W,)
        im = (re_v * vy + im_v * vx + re_w * wy + im_w * wx).sum(dim=1)
        # In the body's axes north turns opposite to the heading; a base's axes point north already.
        direction = [im, 1 + re] if self.corrects else [-im, re]
        if self.states_sigma:
            direction.append(out[:, -1] - 2 * torch.log(size))
        return torch.stack(direction, dim=1)  # (W, 2 or 3)

    def _figures(self, x: Tensor, rest: Tensor, p: Tensor) -> tuple[Tensor, Tensor]:
        """Figures that no turn of the mount changes, (W, F), and the RMS of the velocity that the
        moments do not explain, (W,). rest : (W, T, 4), what they do not explain; p : (K, T)."""
        vx, vy, wx, wy = rest.unbind(dim=2)  # (W, T) each
        of_v = (vx**2 + vy**2).mean(dim=1) + _LEAST  # (W,)
        of_w = (wx**2 + wy**2).mean(dim=1) + _LEAST
        along = (vx * wx + vy * wy).mean(dim=1)
        across = (vy * wx - vx * wy).mean(dim=1)
        figures = [
            torch.log10(of_v) / 2,
            torch.log10(of_w / of_v) / 2,
            torch.tanh(along / of_w),  # the lever arm, m
            torch.tanh(across / of_w),
            torch.sqrt((along**2 + across**2) / (of_v * of_w) + _LEAST),  # coherence
        ]
        lively = torch.matmul(x[..., PER_STEP - 1], p[:_LIVELY_MOMENTS].T / x.shape[1])  # (W, 4)
        return torch.cat([torch.stack(figures, 1), lively, x[:, 0, PER_STEP:]], 1), of_v.sqrt()


def legendre(count: int, degrees: int, like: Tensor) -> Tensor:
    """The first `degrees` Legendre polynomials at the middles of `count` equal steps of [-1, 1]:
    (K, T), of the type and on the device of `like`."""
    t = (2 * torch.arange(count, device=like.device, dtype=like.dtype) + 1) / count - 1
    p = [t * 0 + 1, t]
    for k in range(1, degrees - 1):
        p.append(((2 * k + 1) * t * p[k] - k * p[k - 1]) / (k + 1))
    return torch.stack(p[:degrees])
