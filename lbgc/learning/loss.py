"""The loss functions that training minimises."""

import math

import torch
from torch import Tensor


def cyclic_error_deg(truth_deg: Tensor, estimate_deg: Tensor) -> Tensor:
    """Truth less estimate on the circle, in (-180, 180] degrees (the paper's Algorithm 1)."""
    error = torch.deg2rad(truth_deg - estimate_deg)
    return torch.rad2deg(torch.atan2(torch.sin(error), torch.cos(error)))


def cyclic_mse(truth_deg: Tensor, estimate_deg: Tensor) -> Tensor:
    """Mean square of the error on the circle, deg^2 (the paper's Algorithm 1)."""
    return cyclic_error_deg(truth_deg, estimate_deg).square().mean()


def vector_mse(truth_deg: Tensor, sincos: Tensor) -> Tensor:
    """Mean squared distance of points (sine, cosine), (W, 2), from the truth's on the unit circle.

    For small errors of unit length it is the squared error in rad^2. Unlike the cyclic MSE of an
    angle it has no flat far side and no jump at 180 degrees; its minimum is the mean direction.
    """
    truth = torch.deg2rad(truth_deg)
    target = torch.stack([torch.sin(truth), torch.cos(truth)], dim=-1)
    return (sincos - target).square().sum(dim=-1).mean()


def von_mises_nll(
    reference_deg: Tensor, estimate_deg: Tensor, log_kappa: Tensor, reference_sigma: float = 0.0
) -> Tensor:
    """Mean negative logarithm of the von Mises density exp(kappa cos e)/(2 pi I0(kappa)), in nats.

    reference_sigma : rad, 1 sigma of the reference's own error. The truth scatters about the
    estimate with 1/kappa, and the reference about the truth, in all 1/kappa + reference_sigma^2
    (exact where both are narrow, and where either is zero), so that kappa is that of the truth.

    It is computed in double precision, with I0 scaled by exp(-kappa) and 1 - cos e as
    2 sin^2(e/2): neither overflows nor cancels, down to errors of an arcsecond.
    """
    error = torch.deg2rad(cyclic_error_deg(reference_deg, estimate_deg)).double()
    kappa = 1 / (torch.exp(-log_kappa.double()) + reference_sigma**2)
    away = 2 * torch.sin(error / 2) ** 2
    normaliser = math.log(2 * math.pi) + torch.log(torch.special.i0e(kappa))
    return (normaliser + kappa * away).mean()
