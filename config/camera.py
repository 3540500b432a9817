"""The bench's camera: where it stands, what its lens and sensor do, and what is put up for it to see."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from config.package import Point3
from config.part import Part

MARKER_DICTIONARIES = ("apriltag_16h5", "apriltag_25h9", "apriltag_36h10", "apriltag_36h11")

Coefficient = Annotated[float, Field(ge=-5.0, le=5.0, allow_inf_nan=False)]


class Markers(Part):
    """AprilTags, two on each package's side that faces the camera, as laboratories stick them on."""

    dictionary: Literal["apriltag_16h5", "apriltag_25h9", "apriltag_36h10", "apriltag_36h11"] = (
        "apriltag_36h11"
    )
    size_m: float = Field(
        default=0.08,
        ge=0.01,
        le=1.0,
        description="edge of the black square [m]; smaller where a face is smaller",
    )


class Light(Part):
    """The lamp that casts the shadows; the hall lights the rest."""

    azimuth_deg: float = Field(
        default=-35.0,
        ge=-180.0,
        le=180.0,
        description="from the camera's back, counter-clockwise from above [deg]",
    )
    elevation_deg: float = Field(default=50.0, ge=5.0, le=90.0, description="above the floor [deg]")
    share: float = Field(
        default=0.6, ge=0.0, le=1.0, description="of all light; the rest comes from everywhere"
    )
    shadows: bool = True


class Camera(Part):
    """One fixed camera at the side of the bench. Nothing has to be said: it then sees the whole travel."""

    width_px: int = Field(default=1920, ge=64, le=7680, multiple_of=2, description="picture width")
    height_px: int = Field(default=1080, ge=64, le=4320, multiple_of=2, description="picture height")
    rate_hz: int = Field(
        default=30, ge=1, le=8000, description="pictures a second; divides sampling.poses_hz"
    )
    pictures: int | None = Field(
        default=None,
        ge=2,
        le=100_000,
        description="so many, evenly from the first frame to 0.25 s after the stop, whatever rate_hz says",
    )
    distance_m: float = Field(
        default=4.0,
        ge=0.5,
        le=50.0,
        description="from the load's near side, where position_m is not given [m]",
    )
    position_m: Point3 | None = Field(
        default=None, description="of the lens in frame world [m]; absent: square to the load, half-way"
    )
    aim_m: Point3 | None = Field(
        default=None,
        description="point in frame world in the middle of the picture; absent: the middle of the view",
    )
    position_offset_m: Point3 = Field(
        default=(0.0, 0.0, 0.0), description="added to the place of the lens, in frame world [m]"
    )
    aim_offset_m: Point3 = Field(
        default=(0.0, 0.0, 0.0), description="added to the point that is aimed at, in frame world [m]"
    )
    focal_length_mm: float | None = Field(
        default=None,
        gt=0.0,
        le=2000.0,
        description="absent: load and sled are in the picture over the whole travel",
    )
    zoom: float = Field(
        default=1.0, gt=0.0, le=20.0, description="focal length, given or chosen, times so much"
    )
    sensor_width_mm: float = Field(
        default=20.0, gt=0.0, le=100.0, description="width of the picture on the sensor"
    )
    distortion: tuple[Coefficient, Coefficient, Coefficient, Coefficient, Coefficient] = Field(
        default=(-0.06, 0.02, 0.0, 0.0, 0.0), description="k1, k2, p1, p2, k3 of OpenCV's plumb_bob model"
    )
    shutter_s: float = Field(
        default=0.0005, ge=0.0, le=0.1, description="time of exposure, up to the picture's stamp [s]"
    )
    exposure_ev: float = Field(default=0.0, ge=-5.0, le=5.0, description="brighter by so many stops")
    noise: float = Field(
        default=1.0, ge=0.0, le=50.0, description="standard deviation of a mid-grey pixel, of 255 levels"
    )
    background: Literal["hall", "plain"] = "hall"
    light: Light = Light()
    markers: Markers | None = Field(default=None, description="absent: the cartons as they are")
    film: Literal["clear", "strain"] = Field(
        default="clear", description="as it looks, or coloured by its strain"
    )
    record: Literal["compressed", "raw"] = Field(
        default="compressed", description="JPEG, or every pixel (6 MB a picture of 1920 x 1080)"
    )
    measure: bool = Field(default=False, description="vision_node measures displacement while the graph runs")
    seed: int = Field(default=0, ge=0, le=2**32 - 1, description="of print, tape, wood and noise")

    @model_validator(mode="after")
    def _exposure_is_over_before_the_next(self) -> Self:
        if self.shutter_s * self.rate_hz > 1.0:
            raise ValueError(
                f"shutter_s {self.shutter_s:g} must be at most one picture interval, 1/{self.rate_hz} s"
            )
        return self
