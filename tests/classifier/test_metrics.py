"""Figures of merit against closed forms and cases that are counted by hand."""

import math

import numpy as np
import pytest

from classifier.metrics import (
    COLDEST,
    FIGURES,
    Figure,
    figures,
    fitted_temperature,
    gain,
    logit,
    pr_curve,
    probability,
    reliability,
    roc_curve,
    scores,
)
from config.errors import RefusedInput

PASS, FAIL = True, False
# Called a pass: three of four passes and one of six fails.
TRUTH = np.array([PASS, PASS, PASS, PASS, FAIL, FAIL, FAIL, FAIL, FAIL, FAIL])
TOLD = np.array([0.9, 0.8, 0.7, 0.4, 0.6, 0.3, 0.3, 0.2, 0.1, 0.1])


def test_figures_of_a_case_that_is_counted_by_hand():
    found = scores(TRUTH, logit(TOLD))
    assert tuple(found) == FIGURES
    assert found["accuracy"] == 0.8
    assert found["precision"] == 3 / 4 and found["recall"] == 3 / 4 and found["f1"] == 3 / 4
    right = np.where(TRUTH, TOLD, 1.0 - TOLD)
    assert found["loss"] == pytest.approx(-np.log(right).mean(), rel=1e-12)
    # Of 4 · 6 pairs of a pass and a fail only (0.4, 0.6) stands the wrong way round.
    assert found["roc_area"] == pytest.approx(23 / 24)
    # Precision where each pass comes: 1, 1, 1 and 4/5.
    assert found["pr_area"] == pytest.approx((3 + 4 / 5) / 4)
    # Bins by tenths, |sum of told - passes|: 0.1 and 0.2, 0.2, 0.6, 0.6, 0.6, 0.3, 0.2, 0.1.
    assert found["calibration_error"] == pytest.approx((0.2 + 0.2 + 0.6 + 0.6 + 0.6 + 0.3 + 0.2 + 0.1) / 10)


def test_a_threshold_trades_precision_for_recall():
    strict, lenient = (scores(TRUTH, logit(TOLD), threshold=t) for t in (0.65, 0.35))
    assert (strict["precision"], strict["recall"]) == (1.0, 0.75)
    assert (lenient["precision"], lenient["recall"]) == (0.8, 1.0)
    assert strict["roc_area"] == lenient["roc_area"]


def test_ties_count_half_and_a_judge_that_knows_nothing_has_half_the_area():
    found = scores(TRUTH, np.zeros(10))
    assert found["roc_area"] == 0.5 and found["pr_area"] == pytest.approx(0.4)
    assert found["loss"] == pytest.approx(math.log(2.0))
    assert found["recall"] == 1.0 and found["precision"] == pytest.approx(0.4)


def test_areas_are_those_under_their_curves():
    noise = np.random.default_rng(3)
    truth = noise.random(300) < 0.35
    logits = np.round(1.2 * truth + noise.normal(size=300), 1)
    found = scores(truth, logits)
    wrong, right = roc_curve(truth, logits)
    assert found["roc_area"] == pytest.approx(float(np.trapezoid(right, wrong)))
    recall, precision = pr_curve(truth, logits)
    assert found["pr_area"] == pytest.approx(float((np.diff(recall, prepend=0.0) * precision).sum()))
    # Of the binormal model: Phi(d / sqrt 2), d = 1.2.
    assert found["roc_area"] == pytest.approx(0.5 * (1.0 + math.erf(0.6)), abs=0.05)


def test_what_is_undefined_is_none_and_not_zero():
    told = figures(np.array([FAIL, FAIL]), np.array([-1.0, -2.0]), resamples=50)
    assert told["accuracy"] == Figure(1.0, 1.0, 1.0)
    for name in ("precision", "recall", "f1", "roc_area", "pr_area"):
        assert told[name] == Figure(None, None, None)
    with pytest.raises(RefusedInput, match="one at least"):
        scores(np.zeros(0, dtype=bool), np.zeros(0))
    with pytest.raises(RefusedInput, match="as many logits"):
        scores(TRUTH, np.zeros(9))


def test_huge_logits_neither_overflow_nor_lose_the_loss():
    found = scores(np.array([PASS, FAIL]), np.array([-800.0, -800.0]))
    assert found["loss"] == pytest.approx(400.0)
    assert probability(np.array([-800.0, 0.0, 800.0])).tolist() == [0.0, 0.5, 1.0]


def test_interval_of_an_accuracy_is_the_binomial_one():
    truth = np.zeros(400, dtype=bool)
    logits = np.where(np.arange(400) < 40, 1.0, -1.0)
    told = figures(truth, logits, seed=1)["accuracy"]
    # sqrt(0.9 · 0.1 / 400) = 0.015; resampling of 2000 knows its percentiles to about a tenth of that.
    assert told.value == 0.9
    assert told.low == pytest.approx(0.9 - 1.96 * 0.015, abs=0.003)
    assert told.high == pytest.approx(0.9 + 1.96 * 0.015, abs=0.003)
    assert told == figures(truth, logits, seed=1)["accuracy"]
    assert told != figures(truth, logits, seed=2)["accuracy"]


def test_intervals_over_schemes_are_wider_where_tests_of_one_are_alike():
    truth = np.zeros(400, dtype=bool)
    schemes = [f"scheme {number // 40}" for number in range(400)]
    logits = np.where(np.arange(400) < 40, 1.0, -1.0)
    told = figures(truth, logits, schemes=schemes)["accuracy"]
    # All of one scheme wrong: sqrt(0.9 · 0.1 / 10) = 0.095, and never above 1.
    assert told.low_by_scheme == pytest.approx(0.7, abs=0.05) and told.high_by_scheme == 1.0
    assert told.high - told.low < 0.07
    alone = figures(truth, logits, schemes=[str(number) for number in range(400)])["accuracy"]
    assert alone.low_by_scheme == pytest.approx(alone.low, abs=0.006)


def test_temperature_brings_overconfident_logits_back():
    noise = np.random.default_rng(7)
    true_logits = noise.normal(scale=2.0, size=20_000)
    truth = noise.random(20_000) < probability(true_logits)
    assert fitted_temperature(truth, 3.0 * true_logits) == pytest.approx(3.0, rel=0.05)
    assert fitted_temperature(truth, true_logits) == pytest.approx(1.0, rel=0.05)
    loud, fitted = (scores(truth, logits) for logits in (3.0 * true_logits, true_logits))
    assert fitted["calibration_error"] < 0.01 < loud["calibration_error"]
    assert fitted["loss"] < loud["loss"] and fitted["accuracy"] == loud["accuracy"]
    # Separated tests have no best temperature, tests of one class none at all.
    assert fitted_temperature(TRUTH, np.where(TRUTH, 1.0, -1.0)) == pytest.approx(COLDEST, rel=1e-3)
    assert fitted_temperature(np.ones(3, dtype=bool), np.ones(3)) == 1.0


def test_reliability_says_how_often_a_told_probability_came_true():
    told = np.repeat([0.05, 0.55, 1.0], 20)
    truth = np.concatenate([np.arange(20) < passes for passes in (1, 10, 20)])
    first, middle, last = reliability(truth, logit(np.minimum(told, 1.0 - 1e-12)))
    assert (first.tests, first.share, first.told) == (20, 0.05, pytest.approx(0.05))
    assert (middle.low, middle.high, middle.share) == (0.5, 0.6, 0.5)
    assert (last.low, last.high, last.share_high) == (0.9, 1.0, pytest.approx(1.0))
    # Wilson's interval of 10 of 20.
    assert (middle.share_low, middle.share_high) == pytest.approx((0.2993, 0.7007), abs=1e-4)


def test_gain_is_paired():
    noise = np.random.default_rng(11)
    truth = noise.random(300) < 0.4
    base = np.where(noise.random(300) < 0.8, np.where(truth, 1.0, -1.0), np.where(truth, -1.0, 1.0))
    better = base.copy()
    wrong = np.flatnonzero((base > 0) != truth)[:15]
    better[wrong] *= -1.0
    found = gain(truth, better, base)
    assert found.value == pytest.approx(15 / 300)
    # Only the 15 differ: sqrt(0.05 · 0.95 / 300) = 0.0126.
    assert found.low == pytest.approx(0.05 - 1.96 * 0.0126, abs=0.006)
    assert gain(truth, base, base) == Figure(0.0, 0.0, 0.0)
