"""Smoothly weighted block means of a record, and the Gaussian model they are judged by.

A record of energies swings with the motion. Means over blocks, weighted by
``exp(-1 / (s (1 - s)))``, silence the swing: for quasi-periodic motion faster than any power of the
block length (Das, Saiki, Sander and Yorke, Nonlinearity 30, 2017), for chaotic motion like white
noise. What is left of them is read as

    m_j = c + b j + (Brownian motion of variance s q per block) + (white noise of variance s),

fitted by restricted maximum likelihood over q and generalised least squares for c and b.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from statistics import NormalDist

import numpy as np

from groupoid_gni.array_types import FloatArray

_RATIOS = np.concatenate([[0.0], np.logspace(-5.0, 4.0, 91)])


def block_means(values: FloatArray, blocks: int) -> tuple[FloatArray, int, float]:
    """Weighted means of equal blocks (blocks,), the block length, and kappa.

    kappa is the variance of such a mean of Brownian motion of unit variance per block that starts
    with it. What does not fill a block is left out at the start.
    """
    length = len(values) // blocks
    s = (np.arange(length) + 0.5) / length
    weights = np.exp(-1.0 / (s * (1.0 - s)))
    weights /= np.sum(weights)
    means = values[len(values) - blocks * length :].reshape(blocks, length) @ weights
    behind = np.cumsum(weights[::-1])[::-1] - weights
    kappa = float(np.sum(weights * s * (weights + 2.0 * behind)))
    return means, length, kappa


@dataclass(frozen=True)
class BlockFit:
    """The model fitted to block means, in units of blocks.

    means : (N,).  length : samples per block.  kappa : see ``block_means``.
    """

    means: FloatArray
    length: int
    kappa: float

    @cached_property
    def _scale(self) -> float:
        return float(np.std(self.means))

    @cached_property
    def _covariance(self) -> FloatArray:
        """Of the Brownian part: the time shared by two blocks."""
        places = np.arange(len(self.means))
        shared = np.minimum(places[:, None], places) + 0.5
        return np.asarray(shared + np.diag(np.full(len(places), self.kappa - 0.5)))

    @cached_property
    def _rotated(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Eigenvalues of the covariance, design (N, 2) and means in its eigenvectors."""
        values, vectors = np.linalg.eigh(self._covariance)
        places = np.arange(len(self.means)) - (len(self.means) - 1) / 2.0
        design = np.stack([np.ones(len(places)), places], axis=1)
        return values, vectors.T @ design, vectors.T @ (self.means - self.means[0]) / self._scale

    @cached_property
    def _profile(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """For every q: residual sum, log determinants, coefficients, inverse normal matrix."""
        eigenvalues, design, y = self._rotated
        inverse = 1.0 / (1.0 + _RATIOS[:, None] * eigenvalues)
        normal = np.einsum("ni,gn,nj->gij", design, inverse, design)
        moments = np.einsum("ni,gn,n->gi", design, inverse, y)
        covariances = np.linalg.inv(normal)
        coefficients = np.einsum("gij,gj->gi", covariances, moments)
        rests = y - coefficients @ design.T
        sums = np.sum(rests**2 * inverse, axis=1)
        logarithms = -np.sum(np.log(inverse), axis=1) + np.linalg.slogdet(normal)[1]
        return sums, logarithms, coefficients, covariances

    @property
    def freedom(self) -> int:
        """Degrees of freedom N - 2."""
        return len(self.means) - 2

    @cached_property
    def _likelihoods(self) -> FloatArray:
        sums, logarithms, _, _ = self._profile
        return np.asarray(-0.5 * (self.freedom * np.log(sums + 1e-300) + logarithms))

    @cached_property
    def _best(self) -> int:
        return int(np.argmax(self._likelihoods))

    @property
    def walk_statistic(self) -> float:
        """Twice the log likelihood ratio of a random walk against none."""
        return 2.0 * float(self._likelihoods[self._best] - self._likelihoods[0])

    @property
    def slope(self) -> float:
        """b, change of the means per block."""
        return float(self._profile[2][self._best, 1]) * self._scale

    @property
    def slope_deviation(self) -> float:
        """Standard deviation of ``slope``, random walk included."""
        sums, _, _, covariances = self._profile
        best = self._best
        variance = sums[best] / self.freedom * covariances[best, 1, 1]
        return float(np.sqrt(variance)) * self._scale

    @property
    def walk_variance(self) -> float:
        """s q, variance of the random walk per block."""
        noise = self._profile[0][self._best] / self.freedom
        return float(noise * _RATIOS[self._best]) * self._scale**2

    def walk_interval(self, confidence: float) -> tuple[float, float]:
        """Profile likelihood interval of ``walk_variance``."""
        sums, logarithms, _, _ = self._profile
        variances = np.logspace(-8.0, 3.0, 331)
        noise = variances / _RATIOS[1:, None]
        inner = self.freedom * np.log(noise) + sums[1:, None] / noise + logarithms[1:, None]
        likelihoods = np.max(-0.5 * inner, axis=0)
        constant = -0.5 * self.freedom * (1.0 - np.log(self.freedom))
        none, top = self._likelihoods[0] + constant, self._likelihoods[self._best] + constant
        allowed = top - 0.5 * normal_quantile(confidence) ** 2
        inside = variances[likelihoods >= allowed]
        if not len(inside):
            return 0.0, float(variances[0]) * self._scale**2
        lower = 0.0 if none >= allowed else float(inside[0])
        return lower * self._scale**2, float(inside[-1]) * self._scale**2

    @cached_property
    def _factor(self) -> FloatArray:
        """Cholesky factor of the covariance of the fitted model, in units of the noise."""
        N = len(self.means)
        return np.linalg.cholesky(np.eye(N) + _RATIOS[self._best] * self._covariance)

    @cached_property
    def innovations(self) -> FloatArray:
        """(N,) what the model leaves of the means; white noise when it is right."""
        N = len(self.means)
        level = self._profile[2][self._best, 0] * self._scale
        trend = level + self.slope * (np.arange(N) - (N - 1) / 2.0)
        return np.linalg.solve(self._factor, self.means - self.means[0] - trend)

    def slow_structure(self) -> float:
        """Chance that white innovations have that much power at their lowest frequencies."""
        from scipy.special import fdtrc

        power = np.abs(np.fft.rfft(self.innovations)[1:]) ** 2
        low = max(2, len(self.means) // 16)
        ratio = np.mean(power[:low]) / np.mean(power[low:])
        return float(fdtrc(2 * low, 2 * (len(power) - low), ratio))

    def single_line(self) -> float:
        """Chance that white innovations have one frequency standing out that much (Fisher's g)."""
        power = np.abs(np.fft.rfft(self.innovations)[1:]) ** 2
        largest = float(np.max(power) / np.sum(power))
        return min(1.0, len(power) * (1.0 - largest) ** (len(power) - 1))

    def exponent(self, confidence: float, seed: int = 1) -> tuple[float, tuple[float, float]]:
        """Slope of log mean squared increment over log lag, with an interval from the model.

        0 for bounded swings, 1 for a random walk, 2 for a linear drift. The interval is the spread
        of the slope over 200 records drawn from the fitted model.
        """
        N = len(self.means)
        rng = np.random.default_rng(seed)
        noise = np.sqrt(self._profile[0][self._best] / self.freedom) * self._scale
        drawn = noise * (self._factor @ rng.normal(size=(N, 200))).T
        slopes = _increment_slopes(drawn + self.slope * np.arange(N))
        found = float(_increment_slopes(self.means[None])[0])
        spread = normal_quantile(confidence) * float(np.std(slopes))
        return found, (found - spread, found + spread)


def _increment_slopes(records: FloatArray) -> FloatArray:
    """Of each record (k, N): least squares slope of log S(l) over log l, l = 1 ... N / 4."""
    lags = np.arange(1, records.shape[1] // 4 + 1)
    sizes = [np.mean((records[:, lag:] - records[:, :-lag]) ** 2, axis=1) for lag in lags]
    logs, x = np.log(np.array(sizes) + 1e-300), np.log(lags)
    x = x - np.mean(x)
    return np.asarray(x @ logs / (x @ x))


def normal_quantile(confidence: float) -> float:
    """z with P(|Z| < z) = confidence."""
    return NormalDist().inv_cdf(0.5 + confidence / 2.0)


def student_quantile(confidence: float, freedom: int) -> float:
    """The same for Student's t."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.5 + confidence / 2.0))
