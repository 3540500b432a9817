"""Settled tests become examples, and no scheme of the test part stands in another."""

import json

import numpy as np
import pytest

from classifier.examples import Split, read_examples, split_at_random, split_by_scheme
from config.errors import RefusedInput
from recordings.campaigns.store import test_folder
from tests.classifier.drawn_campaign import example, label


def _folder(path, verdicts):
    (path / "tests").mkdir()
    (path / "campaign.json").write_text(json.dumps({"campaign": {"name": "few"}}))
    for number, verdict in verdicts.items():
        test_folder(path, number).mkdir()
        text = label(number, verdict, "bricks").to_json()
        (test_folder(path, number) / "label.json").write_text(text)
    return path


def _many(schemes: int = 26, tests: int = 800):
    """Schemes of very different size and rate of passes."""
    rng = np.random.default_rng(3)
    share, rate = rng.dirichlet(np.full(schemes, 3.0)), rng.uniform(0.05, 0.7, schemes)
    scheme = rng.choice(schemes, size=tests, p=share)
    return [
        example(number, "pass" if rng.random() < rate[k] else "fail", f"scheme{k}")
        for number, k in enumerate(scheme)
    ]


def _parts(split: Split):
    return (split.train, split.validation, split.test)


def _covers_all(split: Split, count: int):
    assert sorted(index for part in _parts(split) for index in part) == list(range(count))
    assert all(list(part) == sorted(part) and part for part in _parts(split))


def test_examples_are_the_settled_tests_by_number(tmp_path):
    found = read_examples(_folder(tmp_path, {7: "fail", 2: "pass", 5: "unresolved"}))
    assert [(e.number, e.success, e.scheme) for e in found] == [(2, True, "bricks"), (7, False, "bricks")]
    assert found[0].bag == tmp_path / "tests" / "00002" / "bag"


def test_a_folder_without_a_settled_test_is_refused(tmp_path):
    with pytest.raises(RefusedInput, match="must be the folder of a campaign"):
        read_examples(tmp_path)
    with pytest.raises(RefusedInput, match="no test yet that passed or failed"):
        read_examples(_folder(tmp_path, {0: "unresolved"}))


def test_no_scheme_of_the_test_part_is_in_another_and_shares_and_balance_come_close():
    examples = _many()
    split = split_by_scheme(examples, seed=1)
    _covers_all(split, len(examples))
    of_part = [{examples[k].scheme for k in part} for part in _parts(split)]
    assert not of_part[0] & of_part[2] and not of_part[1] & of_part[2] and of_part[1] <= of_part[0]
    usual = np.mean([e.success for e in examples])
    for part, share in zip(_parts(split), (0.7, 0.1, 0.2), strict=True):
        # A scheme has 3 % of the tests on average: a part can be hit to a fraction of that.
        assert len(part) / len(examples) == pytest.approx(share, abs=0.015)
        assert np.mean([examples[k].success for k in part]) == pytest.approx(usual, abs=0.03)


@pytest.mark.parametrize("split", [split_by_scheme, split_at_random])
def test_same_seed_same_split_and_another_seed_another(split):
    examples = _many()
    assert split(examples, seed=4) == split(examples, seed=4) != split(examples, seed=5)


def test_a_random_split_shares_out_both_classes_alike():
    examples = _many()
    split = split_at_random(examples, seed=0, test_share=0.3, validation_share=0.2)
    _covers_all(split, len(examples))
    for verdict in (True, False):
        of_class = [sum(examples[k].success == verdict for k in part) for part in _parts(split)]
        assert of_class[2] == round(0.3 * sum(of_class)) and of_class[1] == round(0.2 * sum(of_class))


def test_three_schemes_make_three_parts_and_two_are_refused():
    split = split_by_scheme(_many(3, 60), seed=0)
    _covers_all(split, 60)
    with pytest.raises(RefusedInput, match="schemes = 2: must be at least 3"):
        split_by_scheme(_many(2, 20), seed=0)
    with pytest.raises(RefusedInput, match="leaves nothing to train on"):
        split_at_random(_many(3, 60), seed=0, test_share=0.6, validation_share=0.4)
