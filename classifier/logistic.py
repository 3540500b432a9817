"""Logistic regression on standardised features, with a quadratic penalty that is chosen on validation tests."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from classifier.metrics import Truth, logit, scores
from sim_core.frames import Array

PENALTIES = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
"""Half of it times the squared weights is added to the mean cross-entropy."""


@dataclass(frozen=True, eq=False)
class Logistic:
    """A fitted regression.

    Attributes:
        mean: of each feature in training.
        deviation: of it.
        weights: of the standardised features.
        bias: logit of success where all features have their means.
        penalty: that was chosen.
    """

    mean: Array
    deviation: Array
    weights: Array
    bias: float
    penalty: float

    def logits(self, features: Array) -> Array:
        """Logits of success, shape [n], of features, shape [n, feature_count]."""
        return np.asarray((features - self.mean) / self.deviation @ self.weights + self.bias)


def fitted_logistic(features: Array, success: Truth, *, penalty: float) -> Logistic:
    """The regression of the least penalised mean cross-entropy.

    Args:
        features: shape [n, feature_count].
        success: whether each test passed, shape [n].
        penalty: of the squared weights; the bias is free.
    """
    mean, deviation = features.mean(axis=0), features.std(axis=0)
    deviation = np.where(deviation > 1.0e-9, deviation, 1.0)
    given = np.column_stack(((features - mean) / deviation, np.ones(len(features))))
    sign = np.where(success, 1.0, -1.0)
    held = np.append(np.full(features.shape[1], penalty), 0.0)

    def cost(weights: Array) -> tuple[float, Array]:
        right = sign * (given @ weights)
        pull = -sign * np.exp(-np.logaddexp(0.0, right))
        value = np.logaddexp(0.0, -right).mean() + 0.5 * (held * weights**2).sum()
        return float(value), given.T @ pull / len(sign) + held * weights

    found = minimize(cost, np.zeros(given.shape[1]), jac=True, method="L-BFGS-B", options={"maxiter": 2000}).x
    return Logistic(mean, deviation, found[:-1], float(found[-1]), penalty)


def chosen_logistic(train: tuple[Array, Truth], validation: tuple[Array, Truth]) -> Logistic:
    """The regression whose penalty has the least cross-entropy on validation tests.

    Args:
        train: features and success of the tests to learn from.
        validation: of those to choose by; none: the middle penalty.
    """
    fits = [fitted_logistic(*train, penalty=penalty) for penalty in PENALTIES]
    if not len(validation[1]):
        return fits[len(fits) // 2]
    return min(fits, key=lambda fit: scores(validation[1], fit.logits(validation[0]))["loss"])


def prior_logit(success: Truth) -> float:
    """Logit of the share of passes, never quite 0 or 1 (half a test is added to either)."""
    return float(logit(np.array((success.sum() + 0.5) / (len(success) + 1.0))))
