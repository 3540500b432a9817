"""The page's section on what the camera saw: three pictures and the video."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from config.scene import Scene
from sim_core.report_figures import Report
from sim_core.report_words import safe_text

LARGEST_VIDEO = 16 * 2**20
"""Videos above stay beside the page [bytes]."""
_NAMES = {"start": "Before the start", "peak": "Largest displacement", "end": "At the end"}


class ShownPicture(Protocol):
    """A picture for the page, as ``sim_core.camera.key_pictures`` makes them."""

    @property
    def name(self) -> str:
        """``start``, ``peak`` or ``end``."""

    @property
    def time_s(self) -> float:
        """Since the first picture [s]."""

    @property
    def jpeg(self) -> bytes:
        """The picture."""

    @property
    def width_px(self) -> int:
        """Its width."""

    @property
    def height_px(self) -> int:
        """Its height."""


@dataclass(frozen=True)
class ReportPictures:
    """What the page shows of the camera.

    Attributes:
        key: start, peak and end.
        video: the video as MP4, or None.
    """

    key: Sequence[ShownPicture]
    video: bytes | None = None


def camera_section(report: Report, scene: Scene, pictures: ReportPictures | None) -> str:
    """Key frames and video as HTML, or nothing where no picture was taken."""
    camera = scene.camera
    if camera is None or pictures is None or not pictures.key:
        return ""
    figures = "\n".join(
        f'<figure class="picture"><img alt="{safe_text(_NAMES[shown.name])}" width="{shown.width_px}"'
        f' height="{shown.height_px}" src="data:image/jpeg;base64,{base64.b64encode(shown.jpeg).decode()}">'
        f"<figcaption>{safe_text(_NAMES[shown.name])}, {shown.time_s:.2f} s</figcaption></figure>"
        for shown in pictures.key
    )
    video = ""
    if pictures.video is not None and len(pictures.video) <= LARGEST_VIDEO:
        video = (
            '<figure class="picture"><video controls loop muted preload="metadata" src="data:video/mp4;base64,'
            f'{base64.b64encode(pictures.video).decode()}"></video>'
            f"<figcaption>The whole test at {report['camera']['rate_hz']:.4g} pictures a second, in real time"
            "</figcaption></figure>"
        )
    told = report["camera"]
    return (
        "<section><h2>What the camera saw</h2>\n"
        f"<p>{told['pictures']} pictures of {camera.width_px} × {camera.height_px} px, focal length"
        f" {told['focal_length_mm']:.1f} mm, {told['distance_m']:.2f} m from the load's near side; drawn by"
        f" {safe_text(told['drawn_by'])}.</p>\n{figures}\n{video}{_measured(report)}</section>"
    )


def _measured(report: Report) -> str:
    """What vision_node made of the pictures, beside the judge."""
    measured = report.get("vision")
    if measured is None:
        return ""
    judged = {rule["rule"]: rule for rule in report["rules"]}
    rows = "\n".join(
        f'<tr><th scope="row">{safe_text(rule["title"])}</th><td>{_figure(rule["worst_mm"])}</td>'
        f"<td>{_figure(rule['error_mm'])}</td><td>{_figure(judged[rule['rule']]['worst_mm'])}</td>"
        f"<td>{_figure(rule['limit_mm'])}</td><td>{safe_text(rule['state'])}</td></tr>"
        for rule in measured["rules"]
    )
    unseen = "".join(f"<li>{safe_text(line)}</li>" for line in measured["unseen"])
    return (
        f"<h3>Measured from the pictures alone: {safe_text(measured['verdict'])}</h3>\n<table><thead><tr><th>Rule</th>"
        "<th>Measured, mm</th><th>± mm, 95 %</th><th>Simulated, mm</th><th>Limit, mm</th><th>State</th></tr></thead>"
        f"<tbody>{rows}</tbody></table>\n" + (f"<p>Not seen:</p><ul>{unseen}</ul>" if unseen else "")
    )


def _figure(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f}"
