"""Measures pictures as they come and says so in messages: the same for a run, a node and a recording."""

from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

from config.scene import Scene
from msgs_adapters.camera_payloads import Calibration
from msgs_adapters.publications import Publication, displacement_publication, vision_report_publication
from msgs_adapters.vision_payloads import displacement_payload
from sim_core.report import Report, report_json
from sim_core.vision.measure import DisplacementMeasurer, Measurement
from sim_core.vision.verdict import MeasuredTest


class LiveMeasurement:
    """Takes pictures in order and gives out what they say.

    Args:
        scene: a resolved scene with a camera.
        calibration: of the camera that took the pictures.

    Raises:
        RefusedInput: no package faces the camera.
    """

    def __init__(self, scene: Scene, calibration: Calibration) -> None:
        self.measurer = DisplacementMeasurer(
            scene, calibration.matrix, calibration.distortion, calibration.width, calibration.height
        )
        self._faces = np.array([face.corners for face in self.measurer.faces])

    def take(self, stamp_ns: int, pixels: NDArray[np.uint8]) -> tuple[Measurement, Publication]:
        """Measures the next picture, taken at a stamp [ns].

        Raises:
            RefusedInput: it has another size, comes too early, or is the first one and shows too few targets.
        """
        measured = self.measurer.take(stamp_ns, pixels)
        payload = displacement_payload(
            stamp_ns,
            side=self.measurer.side,
            faces=self._faces,
            rows=measured.rows,
            displacement=measured.displacement,
            sigma=measured.sigma,
            states=measured.states,
        )
        return measured, displacement_publication(stamp_ns, payload)

    def finish(self) -> tuple[Report, Publication]:
        """The judgement of all pictures, and the message that says it.

        Raises:
            RefusedInput: there was no picture.
        """
        entry = measured_entry(self.measurer.result())
        stamp_ns = self.measurer.measurements[-1].stamp_ns
        return entry, vision_report_publication(stamp_ns, report_json(entry, compact=True))


def measured_entry(measured: MeasuredTest) -> Report:
    """A measured test as the report has it: verdict, rules, bands, packages, and what was not seen."""
    worst = {rule.rule: rule.worst_mm for rule in measured.rules}
    return {
        "verdict": measured.verdict,
        "elastic_mm": worst.get("elastic"),
        "permanent_mm": worst.get("permanent"),
        "pictures": measured.picture_count,
        "rules": [asdict(rule) for rule in measured.rules],
        "bands": [asdict(band) for band in measured.bands],
        "packages": [asdict(package) for package in measured.packages],
        "unseen": measured.unseen,
    }
