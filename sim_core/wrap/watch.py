"""What the film went through: its largest strain and pull, where and when, and what it has left."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sim_core.frames import Array
from sim_core.wrap.membrane import membrane_state

if TYPE_CHECKING:
    from sim_core.wrap.load_film import LoadFilm


@dataclass
class FilmSummary:
    """The film's part of a report.

    Attributes:
        nodes: number of nodes of its mesh.
        peak_strain: largest strain in any direction, from the tension-free film.
        peak_position_m: middle of that element then, frame ``sled`` [m].
        peak_time_s: when [s].
        start_force_npm: largest pull in the settled load, of all layers together [N/m].
        peak_force_npm: largest pull in any direction [N/m].
        torn: number of torn elements.
        lost_j: elastic energy lost by flowing and tearing [J].
        residual_n: largest force left on a node [N].
    """

    nodes: int
    peak_strain: float = 0.0
    peak_position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    peak_time_s: float = 0.0
    start_force_npm: float = 0.0
    peak_force_npm: float = 0.0
    torn: int = 0
    lost_j: float = 0.0
    residual_n: float = 0.0


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
        self.summary = FilmSummary(len(film.nodes))
        self.take(0.0, 0.0)
        self.summary.start_force_npm = self.summary.peak_force_npm

    def take(self, time_s: float, lost_j: float) -> None:
        """Looks at the film as it is.

        Args:
            time_s: time since the first frame [s].
            lost_j: energy that it has lost since the last look [J].
        """
        load_film, elements, kept = self._film, self._film.film, self.summary
        membrane_state(
            load_film.nodes, elements.triangles, elements.inverse_reference, elements.stiffness, elements.set_strain,
            elements.torn, self._strains, self._forces,
        )  # fmt: skip
        largest = np.where(elements.torn, -1.0, self._strains[:, 3])
        worst = int(largest.argmax())
        if largest[worst] > kept.peak_strain:
            x, y, z = load_film.nodes[elements.triangles[worst]].mean(axis=0).tolist()
            kept.peak_strain, kept.peak_position_m = float(largest[worst]), (x, y, z)
            kept.peak_time_s = time_s
        kept.peak_force_npm = max(kept.peak_force_npm, float(self._forces.max(initial=0.0)))
        kept.torn = int(elements.torn.sum())
        kept.lost_j += lost_j
        kept.residual_n = max(kept.residual_n, load_film.residual_n)
