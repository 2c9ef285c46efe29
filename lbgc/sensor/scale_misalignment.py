"""Scale factor and misalignment of a gyro triad, estimated from Earth's horizontal rate at known
headings.

The error of a resting triad is b + M w, with w Earth's rate in the body. From heading to heading
the horizontal part of w goes round a circle, while its vertical part stays the same. So the first
two columns of M can be told from b where the horizontal rates do not all lie on one line through
that circle, and the third column cannot.
"""

from dataclasses import dataclass

import numpy as np

_SEEN = 0.01
"""The least mean square spread of the horizontal rate along a direction, over its mean square, for
which the gain along that direction is estimated: an rms of a tenth of the circle's radius. A full
circle has 1/2."""


@dataclass(frozen=True)
class Gain:
    """The part of a triad's error that is proportional to Earth's horizontal rate."""

    directions: np.ndarray
    """(2, k), k 0 to 2: unit vectors, forward and right, along which w varies enough"""
    slope: np.ndarray
    """(k, 3), error of each axis per rate along each of these directions"""
    covariance: np.ndarray
    """(k, k), covariance of each column of `slope`, per variance of the scatter"""
    scatter: np.ndarray
    """(3,), rad/s, standard deviation of what is left of the errors: of recordings within sessions,
    or of the sessions' means"""
    freedom: int
    """Degrees of freedom of that scatter"""
    within: bool
    """Whether it was estimated from the recordings within each session, not from sessions' means"""
    missing: str | None
    """The headings that are missing where k is below 2"""

    def predicted(self, truth: np.ndarray) -> np.ndarray:
        """The error M w as far as M was estimated: truth w (R, 3), rad/s -> (R, 3), rad/s."""
        return np.asarray(truth[:, :2] @ self.directions @ self.slope)

    @property
    def matrix(self) -> np.ndarray | None:
        """M with its third column zero, (3, 3); None where k is below 2."""
        if self.missing is not None:
            return None
        return np.column_stack([(self.directions @ self.slope).T, np.zeros(3)])

    @property
    def matrix_sigma(self) -> np.ndarray | None:
        """(2, 2), standard errors of the horizontal axes' elements of M; None where k is below
        2."""
        if self.missing is not None:
            return None
        unit = self.directions @ self.covariance @ self.directions.T
        return np.outer(self.scatter[:2], np.sqrt(np.diag(unit)))


def gain(error: np.ndarray, truth: np.ndarray, session: np.ndarray) -> Gain:
    """Estimate the gain by least squares, together with one constant a session where the sessions
    have headings enough of their own, else from the sessions' means. Either way Student's t holds
    for it, however much the sessions' biases differ.

    error, truth : (R, 3), rad/s, errors and Earth's rate in the body; session : (R,), any labels.
    """
    _, which = np.unique(session, return_inverse=True)
    groups, count = int(which.max()) + 1, len(error)
    size = np.bincount(which)[:, None]

    def means(values: np.ndarray) -> np.ndarray:
        total = np.zeros((groups, values.shape[1]))
        np.add.at(total, which, values)
        return np.asarray(total / size)

    of_session = means(error), means(truth[:, :2])
    within = error - of_session[0][which], truth[:, :2] - of_session[1][which]
    between = tuple(v - v.mean(axis=0) for v in of_session)
    reach = float(np.sqrt(np.mean(np.sum(truth[:, :2] ** 2, axis=1))))
    options = [
        (_seen(x, reach, rows, free), y, x, free, inside)
        for (y, x), rows, free, inside in (
            (within, count, count - groups, True),
            (between, groups, groups - 1, False),
        )
    ]
    directions, y, x, free, inside = max(options, key=lambda option: option[0].shape[1])
    regressors = x @ directions
    k = directions.shape[1]
    normal = np.linalg.inv(regressors.T @ regressors)
    slope = normal @ regressors.T @ y
    rest = y - regressors @ slope
    scatter = np.sqrt(np.sum(rest**2, axis=0) / max(free - k, 1))
    missing = None if k == 2 else _missing(truth[:, :2], reach, count, groups)
    return Gain(directions, slope, normal, scatter, free - k, inside, missing)


def _seen(x: np.ndarray, reach: float, rows: int, free: int) -> np.ndarray:
    """The directions, (2, k), along which the centred rates x (rows, 2) spread enough compared with
    `reach`, the rms of the horizontal rate. None, (2, 0), where fitting them would leave less than
    one of the `free` degrees of freedom."""
    values, vectors = np.linalg.eigh(x.T @ x / rows / reach**2)
    seen = vectors[:, values > _SEEN]
    return seen if free - seen.shape[1] >= 1 else np.zeros((2, 0))


def _missing(horizontal: np.ndarray, reach: float, count: int, groups: int) -> str:
    """The sentence that says which headings or recordings are missing for the first two columns of
    M."""
    x = horizontal - horizontal.mean(axis=0)
    values, vectors = np.linalg.eigh(x.T @ x / count / reach**2)
    if values[1] <= _SEEN:
        middle = horizontal.mean(axis=0)
        have = np.rad2deg(np.arctan2(-middle[1], middle[0])) % 360
        others = ", ".join(f"{(have + turn) % 360:.0f}" for turn in (90, 180, 270))
        return f"every heading is near {have:.0f} deg; headings near {others} deg are missing"
    if values[0] <= _SEEN:
        x, y = vectors[:, 0]
        one = np.rad2deg(np.arctan2(-y, x)) % 180
        return f"headings near {one:.0f} and {one + 180:.0f} deg are missing"
    if groups > 1:
        return (
            "each session has too few headings of its own, and there are too few sessions: three "
            "headings in one session and two recordings more, or five sessions, are missing"
        )
    return f"{count} recordings leave nothing to judge it by: more recordings are missing"
