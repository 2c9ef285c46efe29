"""The paper's published figures, for comparison: Engelsman & Klein, tables III, I and that of
hyperparameters."""

from collections.abc import Mapping

WINDOWS_S = (10.0, 20.0, 30.0, 60.0, 240.0)
MEDIAN_DEG = {"baseline": (5.06, 4.73, 4.68, 3.67, 3.41), "learned": (3.27, 2.68, 2.52, 1.96, 1.51)}
IQR_DEG = {"baseline": (5.62, 4.63, 5.66, 4.27, 3.72), "learned": (3.07, 2.71, 2.11, 1.90, 1.62)}
PARAMETERS = {(1, 8): 9265, (2, 16): 42065, (2, 24): 98965}
"""Number of parameters by (layers, hidden). A Bi-LSTM on three channels with a fully connected
layer a direction has 850, 9,122 and 19,826."""
LATENCY_MS = {(1, 8): 3.99, (2, 16): 7.81, (2, 24): 26.62}
ERROR_DEG = {(1, 8): (2.81, 0.71), (2, 16): (2.13, 0.30), (2, 24): (1.91, 0.26)}
"""Error and its spread by (layers, hidden)."""


def published(table: Mapping[str, tuple[float, ...]], row: str, window_s: float) -> float | None:
    """A published figure, or None where the paper has none for this window."""
    return table[row][WINDOWS_S.index(window_s)] if window_s in WINDOWS_S else None
