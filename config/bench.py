"""What was found in the accelerometer's readings that drive a sled: it stays with the scene, and in the report."""

from typing import Literal

from pydantic import Field

from config.package import Point3
from config.part import Part


class ImuSource(Part):
    """How readings of an accelerometer became the samples of a sled, with every fault that was found and handled."""

    topic: str = Field(default="", description="absolute name of the Imu topic")
    start_ns: int = Field(description="when sample 0 was, on the recording's clock [ns]")
    readings: int = Field(ge=0)
    rate_hz: float = Field(description="of the readings, from their median interval [Hz]")
    jitter_ms: float = Field(description="standard deviation of the intervals, gaps aside [ms]")
    missing: int = Field(description="readings that the gaps swallowed")
    longest_gap_ms: float = Field(description="longest time between two readings, anywhere [ms]")
    longest_gap_in_motion_ms: float = Field(description="the longest that was bridged [ms]; 0 without one")
    noise_mps2: Point3 = Field(description="standard deviation at rest, sensor's axes [m/s²]")
    gravity_mps2: float = Field(
        description="magnitude of the reading at rest [m/s²]; about 0: taken off already"
    )
    bias_mps2: Point3 = Field(
        description="sensor's axes [m/s²]; across the travel it cannot be told from a roll, and counts as roll"
    )
    bias_change_mps2: float = Field(description="how far the reading at rest moved between both ends [m/s²]")
    rotation: tuple[Point3, Point3, Point3] = Field(
        description="rows of the matrix that turns readings into frame sled"
    )
    tilt_deg: float = Field(description="angle between the sensor's z axis and up [deg]")
    yaw_deg: float = Field(description="angle in plan between the sensor's x axis and frame sled's [deg]")
    off_axis_share: float = Field(
        description="acceleration across the travel beyond the noise, as a share of that along it; left out"
    )
    moves_from_s: float = Field(description="start of the motion, since the first reading [s]")
    moves_until_s: float = Field(description="end of the motion, since the first reading [s]")
    ends: Literal["standing", "coasting"] = Field(
        description="how the sled goes on after the last acceleration"
    )
    end_speed_mps: float = Field(description="speed that the readings leave at the end [m/s]")
    drift_mps2: float = Field(
        description="constant that was taken off over the motion so that the sled stands [m/s²]"
    )
    speed_sigma_mps: float = Field(
        description="largest standard uncertainty of the speed, from the noise [m/s]"
    )
    travel_sigma_mm: float = Field(description="standard uncertainty of the travel, from the noise [mm]")
    clock_offset_ms: float | None = Field(
        default=None, description="the recording's clock ahead of the sensor's, least delay included [ms]"
    )
    clock_drift_ppm: float | None = Field(
        default=None, description="the recording's clock gains so much on the sensor's"
    )
    uses_sensor_clock: bool = Field(
        default=True, description="False where the readings were moved to the recording's clock"
    )
