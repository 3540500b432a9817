"""Every topic of the twin with its type and quality of service, and the names of its frames."""

from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any, Literal
from urllib.parse import quote

from config.errors import RefusedInput

TWIN_NAMESPACE = "/twin"

WORLD_FRAME = "world"
SLED_FRAME = "sled"
PALLET_FRAME = "pallet"
CAMERA_FRAME = "camera_optical"


@dataclass(frozen=True)
class QosSpec:
    """The parts of a ROS quality of service that the twin chooses; the history is always *keep last*."""

    reliability: Literal["reliable", "best_effort"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"
    depth: int = 10


# A queue of 5000 lost nothing at 1 kHz after matching, one of 100 did (Fast DDS 2.14, measured).
STREAM = QosSpec(depth=5000)
LATCHED = QosSpec(durability="transient_local", depth=1)
# Views may lose frames, and 5000 marker arrays of a large load would be 80 MB.
VIEW = QosSpec(depth=100)
STATUS = QosSpec(depth=100)
# Ten seconds at 30 Hz; a raw picture of 1080p takes 6 MB, and the sender keeps what a slow reader hasn't taken.
PICTURES = QosSpec(depth=300)
RAW_PICTURES = QosSpec(depth=60)


@dataclass(frozen=True)
class Topic:
    """A topic.

    Attributes:
        name: relative unless it starts with a slash.
        type_name: such as ``geometry_msgs/msg/PoseArray``.
        qos: what the publisher offers.
    """

    name: str
    type_name: str
    qos: QosSpec

    def absolute_name(self, namespace: str = TWIN_NAMESPACE) -> str:
        """The name under ``namespace``; a name that is absolute already stays as it is."""
        return self.name if self.name.startswith("/") else f"{namespace.rstrip('/')}/{self.name}"

    def in_namespace(self, namespace: str = TWIN_NAMESPACE) -> "Topic":
        """The same topic under its absolute name."""
        return replace(self, name=self.absolute_name(namespace))


CLOCK = Topic("/clock", "rosgraph_msgs/msg/Clock", STREAM)
SLED_ACCELERATION = Topic("sled/acceleration", "geometry_msgs/msg/AccelStamped", STREAM)
SLED_ACCELEROMETER = Topic("sled/accelerometer", "sensor_msgs/msg/Imu", STREAM)
SLED_ODOMETRY = Topic("sled/odometry", "nav_msgs/msg/Odometry", STREAM)
PACKAGES_POSES = Topic("packages/poses", "geometry_msgs/msg/PoseArray", STREAM)
PACKAGES_MARKERS = Topic("packages/markers", "visualization_msgs/msg/MarkerArray", VIEW)
WRAP_STRAIN = Topic("wrap/strain", "sensor_msgs/msg/PointCloud2", STREAM)
WRAP_MESH = Topic("wrap/mesh", "visualization_msgs/msg/Marker", VIEW)
ROBOT_DESCRIPTION = Topic("robot_description", "std_msgs/msg/String", LATCHED)
SCENE = Topic("scene", "std_msgs/msg/String", LATCHED)
PHYSICS_PROGRESS = Topic("physics/progress", "diagnostic_msgs/msg/DiagnosticStatus", STREAM)
DIAGNOSTICS = Topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", STATUS)
EUMOS_STATUS = Topic("eumos/status", "diagnostic_msgs/msg/DiagnosticArray", STATUS)
EUMOS_REPORT = Topic("eumos/report", "std_msgs/msg/String", LATCHED)
CAMERA_IMAGE = Topic("camera/image_raw", "sensor_msgs/msg/Image", RAW_PICTURES)
CAMERA_COMPRESSED = Topic("camera/image_raw/compressed", "sensor_msgs/msg/CompressedImage", PICTURES)
CAMERA_INFO = Topic("camera/camera_info", "sensor_msgs/msg/CameraInfo", PICTURES)
CAMERA_PROGRESS = Topic("camera/progress", "diagnostic_msgs/msg/DiagnosticStatus", STATUS)
VISION_DISPLACEMENT = Topic("vision/displacement", "sensor_msgs/msg/PointCloud2", PICTURES)
VISION_REPORT = Topic("vision/report", "std_msgs/msg/String", LATCHED)
RESIDUAL_DISPLACEMENT = Topic("residual/displacement", "sensor_msgs/msg/PointCloud2", PICTURES)
RESIDUAL_REPORT = Topic("residual/report", "std_msgs/msg/String", LATCHED)
CLASSIFIER_PROBABILITY = Topic("classifier/failure_probability", "std_msgs/msg/Float64", STATUS)
CLASSIFIER_REPORT = Topic("classifier/report", "std_msgs/msg/String", LATCHED)
# Of a replay alone, so no recorder is offered it.
PLAYER_PROGRESS = Topic("player/progress", "diagnostic_msgs/msg/DiagnosticStatus", LATCHED)
# Only in bags: the wheels hold no tf2_msgs.
TF = Topic("/tf", "tf2_msgs/msg/TFMessage", STREAM)

ALL_TOPICS = (
    CLOCK,
    SLED_ACCELERATION,
    SLED_ACCELEROMETER,
    SLED_ODOMETRY,
    PACKAGES_POSES,
    PACKAGES_MARKERS,
    WRAP_STRAIN,
    WRAP_MESH,
    ROBOT_DESCRIPTION,
    SCENE,
    PHYSICS_PROGRESS,
    DIAGNOSTICS,
    EUMOS_STATUS,
    EUMOS_REPORT,
    CAMERA_IMAGE,
    CAMERA_COMPRESSED,
    CAMERA_INFO,
    CAMERA_PROGRESS,
    VISION_DISPLACEMENT,
    VISION_REPORT,
    RESIDUAL_DISPLACEMENT,
    RESIDUAL_REPORT,
    CLASSIFIER_PROBABILITY,
    CLASSIFIER_REPORT,
    TF,
)


def package_frame(package_id: str) -> str:
    """A frame and link name for a package: two ids never share one, and it needs no escape in XML.

    Characters other than letters, digits and ``_.-~`` are percent-encoded (RFC 3986).
    """
    return "package_" + quote(package_id, safe="")


def to_rclpy(spec: QosSpec) -> Any:
    """The ``rclpy.qos.QoSProfile`` that ``spec`` stands for."""
    from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

    return QoSProfile(  # type: ignore[no-untyped-call]
        history=HistoryPolicy.KEEP_LAST,
        depth=spec.depth,
        reliability=ReliabilityPolicy[spec.reliability.upper()],
        durability=DurabilityPolicy[spec.durability.upper()],
    )


def message_class(type_name: str) -> Any:
    """The Python class of a message type such as ``sensor_msgs/msg/Imu``.

    Raises:
        RefusedInput: no such message is installed; ``tf2_msgs`` is not.
    """
    package, _, name = type_name.partition("/msg/")
    # Only plain identifiers may reach the import system: the name can come from a recording.
    if package.isidentifier() and name.isidentifier():
        try:
            return getattr(import_module(f"{package}.msg"), name)
        except (ImportError, AttributeError):
            pass
    raise RefusedInput("message type", type_name, "is not installed")
