"""Films made by hypothesis."""

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from msgs_adapters.stamps import MAX_STAMP_NS
from sim_core.frames import FilmFrame

numbers = st.floats(-(2.0**99), 2.0**99, width=32)


def film(stamp_ns: int, rows: NDArray[np.float32]) -> FilmFrame:
    """A film frame from 21 numbers an element."""
    count = len(rows)
    return FilmFrame(
        8, stamp_ns, rows[:, :9].reshape(count, 3, 3), rows[:, 9:15].reshape(count, 3, 2), rows[:, 15:18],
        *rows[:, 18:].T,
    )  # fmt: skip


films = st.builds(
    film,
    st.integers(0, MAX_STAMP_NS),
    st.integers(0, 5).flatmap(lambda count: arrays(np.float32, (count, 21), elements=numbers)),
)
