"""How far a test was from each limit: what training, and training alone, is told beside pass or fail."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from recordings.campaigns.labels import Label

RULES = ("permanent", "permanent_on_pallet", "elastic")
"""That have a limit; the fourth figure is damage."""
MARGINS = len(RULES) + 1
_LEAST, _MOST = 0.05, 8.0
"""Shares of a limit below and above these are all one."""


@dataclass(frozen=True, eq=False)
class Margins:
    """Where a test stood at its end.

    Attributes:
        shares: worst displacement of each rule as a share of its limit, shape [3]; NaN where none is known.
        is_damaged: whether a package toppled or fell, or film tore.
        failed: whether the test failed.
    """

    shares: NDArray[np.float64]
    is_damaged: bool
    failed: bool

    def stretched(self, factor: float) -> "Margins":
        """The same test, had everything moved that many times as far.

        Damage stays what it was, and so does a failure that neither damage nor a share accounts for.
        """
        if factor == 1.0:
            return self
        is_explained = self.is_damaged or bool((self.shares > 1.0).any())
        shares = self.shares * factor
        stays = self.is_damaged or (self.failed and not is_explained)
        return replace(self, shares=shares, failed=stays or bool((shares > 1.0).any()))

    def figures(self) -> NDArray[np.float32]:
        """Logarithms of the shares, and 1 for damage, shape [MARGINS]; NaN where a share is not known."""
        return np.append(np.log(np.clip(self.shares, _LEAST, _MOST)), float(self.is_damaged)).astype(
            np.float32
        )


def margins_of(label: Label) -> Margins:
    """Of a settled test, by its label."""
    shares = [
        label.worst_mm[rule] / (label.worst_mm[rule] + label.margin_mm[rule])
        if rule in label.worst_mm and rule in label.margin_mm
        else np.nan
        for rule in RULES
    ]
    return Margins(np.array(shares), label.states.get("damage") == "fail", label.success is False)
