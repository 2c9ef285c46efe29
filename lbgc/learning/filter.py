"""A network for bases that sway: a linear filter whose weights it learns, and chooses by what it
sees of the sway.

Velocity v and rate w (lbgc.learning.sway) are horizontal, so complex numbers. Their Legendre
moments m over the window make one number,

    z = sum over k of a_k m_k(v) + b_k m_k(w),

whose angle is the heading, or the correction of a base's. An IMU turned in its mount turns v and w
alike, so z turns with it whatever the complex weights are: they follow, through a few layers, from
figures of the window that no such turn changes. Among these are the size of the sway that the
moments leave, by which a sigma scales, and the lever arm that goes best with the rate.
"""

from itertools import pairwise

import torch
from torch import Tensor, nn

from lbgc.learning.sway import CONSTANTS, PER_STEP

_MOMENTS = 6
_LIVELY_MOMENTS = 4
_FIGURES = 5 + _LIVELY_MOMENTS + CONSTANTS
_LEAST = 1e-12
"""Added to mean squares, and to what is below a root, so that nothing is divided by zero."""


class Filter(nn.Module):
    """(W, T, PER_STEP + CONSTANTS) to sine and cosine, and where it states a sigma the logarithm of
    its concentration: (W, 2 or 3)."""

    def __init__(self, hidden: int, layers: int, outputs: int, corrects: bool):
        super().__init__()
        self.corrects, self.states_sigma = corrects, outputs == 3
        sizes = [_FIGURES, *[hidden] * layers]
        self.inside = nn.ModuleList(nn.Linear(*pair) for pair in pairwise(sizes))
        self.out = nn.Linear(hidden, 4 * _MOMENTS + self.states_sigma)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)
        # Without a base a heading of nothing has no gradient: start somewhere.
        first = torch.zeros(4 * _MOMENTS) if corrects else 0.1 * torch.randn(4 * _MOMENTS)
        self.weights = nn.Parameter(first)

    def forward(self, x: Tensor) -> Tensor:
        p = legendre(x.shape[1], _MOMENTS, x)  # (K, T)
        seen = x[..., :4]  # (W, T, 4): v, w
        m = torch.matmul(p / x.shape[1], seen)  # (W, K, 4)
        of_each = torch.arange(1, 2 * _MOMENTS, 2, device=x.device, dtype=x.dtype)
        rest = seen - torch.matmul(p.T, of_each[:, None] * m)  # (W, T, 4): what moments leave
        figures, size = self._figures(x, rest, p)  # (W, F), (W,)
        h = figures
        for layer in self.inside:
            h = torch.tanh(layer(h))  # (W, H)
        out = self.out(h)  # (W, 4 K [+ 1])
        re_v, im_v, re_w, im_w = (self.weights + out[:, : 4 * _MOMENTS]).split(_MOMENTS, dim=1)
        vx, vy, wx, wy = m.unbind(dim=2)  # (W, K) each
        re = (re_v * vx - im_v * vy + re_w * wx - im_w * wy).sum(dim=1)  # (W,)
        im = (re_v * vy + im_v * vx + re_w * wy + im_w * wx).sum(dim=1)
        # Seen from the body north turns the other way; a base's axes point north already.
        direction = [im, 1 + re] if self.corrects else [-im, re]
        if self.states_sigma:
            direction.append(out[:, -1] - 2 * torch.log(size))
        return torch.stack(direction, dim=1)  # (W, 2 or 3)

    def _figures(self, x: Tensor, rest: Tensor, p: Tensor) -> tuple[Tensor, Tensor]:
        """What no turn of the mount changes, (W, F), and the rms of the velocity left, (W,)."""
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
    """The first so many polynomials at the middles of `count` equal steps of [-1, 1]: (K, T)."""
    t = (2 * torch.arange(count, device=like.device, dtype=like.dtype) + 1) / count - 1
    p = [t * 0 + 1, t]
    for k in range(1, degrees - 1):
        p.append(((2 * k + 1) * t * p[k] - k * p[k - 1]) / (k + 1))
    return torch.stack(p[:degrees])
