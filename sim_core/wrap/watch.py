"""What the film goes through: frames of it to publish, its largest strain and pull, where and when, what it lost."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sim_core.frames import Array, FilmFrame
from sim_core.wrap.membrane import membrane_state

if TYPE_CHECKING:
    from sim_core.wrap.load_film import LoadFilm


@dataclass
class FilmSummary:
    """The film's part of a report.

    Attributes:
        nodes: number of nodes of its mesh.
        elements: number of its elements.
        peak_strain: largest strain in any direction, from the tension-free film.
        peak_position_m: middle of that element then, frame ``sled`` [m].
        peak_time_s: when [s].
        start_force_npm: largest pull in the settled load, of all layers together [N/m].
        peak_force_npm: largest pull in any direction [N/m].
        torn: number of torn elements.
        first_tear_position_m: middle of the element that tore first, frame ``sled`` [m], or None.
        first_tear_time_s: when [s], or None.
        lost_j: elastic energy lost by flowing and tearing [J].
        let_go_s: when a package had toppled or fallen, or torn film found no rest, and it was let go [s], or None.
        residual: largest force left on a node, as a share of the pull of a row of film.
    """

    nodes: int
    elements: int
    peak_strain: float = 0.0
    peak_position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    peak_time_s: float = 0.0
    start_force_npm: float = 0.0
    peak_force_npm: float = 0.0
    torn: int = 0
    first_tear_position_m: tuple[float, float, float] | None = None
    first_tear_time_s: float | None = None
    lost_j: float = 0.0
    let_go_s: float | None = None
    residual: float = 0.0


class FilmWatch:
    """Follows one film from frame to frame.

    Args:
        film: the film around the settled load.
    """

    def __init__(self, film: "LoadFilm") -> None:
        self._film = film
        count = len(film.film.triangles)
        self._strains: Array = np.zeros((count, 5))
        self._forces: Array = np.zeros((count, 2))
        self._peaks: Array = np.zeros(count)
        self._torn_s: Array = np.full(count, -1.0)
        self._seen = -1
        self.summary = FilmSummary(len(film.nodes), count)
        self.take(0.0, 0.0)
        self.summary.start_force_npm = self.summary.peak_force_npm

    def take(self, time_s: float, lost_j: float) -> None:
        """Looks at the film as it is.

        Args:
            time_s: time since the first frame [s].
            lost_j: energy that it has lost since the last look [J].
        """
        load_film, elements, kept = self._film, self._film.film, self.summary
        kept.lost_j += lost_j
        if load_film.answers == self._seen and lost_j == 0.0:
            return
        self._seen = load_film.answers
        membrane_state(
            load_film.nodes, elements.triangles, elements.inverse_reference, elements.stiffness, elements.set_strain,
            elements.torn, self._strains, self._forces,
        )  # fmt: skip
        newly = elements.torn & (self._torn_s < 0.0)
        # What tears has reached its strain; what is torn already has none.
        largest = np.where(elements.torn & ~newly, -1.0, self._strains[:, 3])
        np.maximum(self._peaks, largest, out=self._peaks)
        worst = int(largest.argmax())
        if largest[worst] > kept.peak_strain:
            kept.peak_strain, kept.peak_position_m = float(largest[worst]), self._middle(worst)
            kept.peak_time_s = time_s
        self.note_tears(time_s)
        kept.peak_force_npm = max(kept.peak_force_npm, float(self._forces.max(initial=0.0)))
        kept.residual = max(kept.residual, load_film.residual)

    def note_tears(self, time_s: float) -> None:
        """Notes what has torn by now [s], also of film whose strain says nothing."""
        torn, kept = self._film.film.torn, self.summary
        newly = np.flatnonzero(torn & (self._torn_s < 0.0))
        if not len(newly):
            return
        self._torn_s[newly] = time_s
        kept.torn = int(torn.sum())
        if kept.first_tear_time_s is None:
            first = int(newly[self._peaks[newly].argmax()])
            kept.first_tear_time_s, kept.first_tear_position_m = time_s, self._middle(first)

    def frame(self, index: int, stamp_ns: int) -> FilmFrame:
        """The film at the last look, to be published with a pose frame's number and stamp [ns]."""
        film = self._film.film
        return FilmFrame(
            index=index,
            stamp_ns=stamp_ns,
            corners=self._film.nodes[film.triangles].astype(np.float32),
            unrolled=self._film.unrolled,
            strains=self._strains[:, [3, 0, 1]].astype(np.float32),
            peaks=self._peaks.astype(np.float32),
            forces=self._forces[:, 0].astype(np.float32),
            torn_s=self._torn_s.astype(np.float32),
        )

    def _middle(self, element: int) -> tuple[float, float, float]:
        x, y, z = self._film.nodes[self._film.film.triangles[element]].mean(axis=0).tolist()
        return x, y, z
