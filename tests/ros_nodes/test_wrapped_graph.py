"""A wrapped load as a node graph: the bytes of a run, film and tearing included, and a mesh for who looks."""

import json
import subprocess
import sys
from pathlib import Path

from config.scene import Scene
from config.scene_file import validate_scene
from recordings.judge_bag import judge_bag
from ros_nodes.supervisor import Supervisor
from sim_core.report import judgement, report_json
from tests.ros_nodes.graph import environment, missing_of, pallet_twin, payloads
from tests.torn_scene import TORN

VIEWER = """
import sys, time, rclpy, rclpy.executors
from visualization_msgs.msg import Marker
rclpy.init()
node = rclpy.create_node("viewer", namespace="/twin")
meshes = []
node.create_subscription(Marker, "wrap/mesh", meshes.append, 100)
executor = rclpy.executors.SingleThreadedExecutor()
executor.add_node(node)
until = time.monotonic() + 60.0
while time.monotonic() < until:
    executor.spin_once(timeout_sec=0.2)
    if meshes and not node.count_publishers("wrap/mesh"):
        break
print([(m.type, m.header.frame_id, len(m.points) // 3, len(m.colors) // 3) for m in meshes])
"""


def test_graph_gives_the_bytes_of_a_run_while_somebody_looks(tmp_path: Path) -> None:
    (tmp_path / "scene.json").write_text(json.dumps(TORN))
    env = {**environment(), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    viewer = subprocess.Popen([sys.executable, "-c", VIEWER], env=env, stdout=subprocess.PIPE, text=True)
    try:
        up = pallet_twin("up", "scene.json", "--out", "up", "--no-estimate", cwd=tmp_path, env=env)
        assert up.returncode == 0, up.stderr
        seen = eval(viewer.communicate(timeout=30)[0])
    finally:
        viewer.kill()
    run = pallet_twin("run", "scene.json", "--out", "run", "--no-estimate", cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    bags = [tmp_path / name / "bag" for name in ("up", "run")]
    for topic in ("packages/poses", "wrap/strain", "eumos/status", "eumos/report", "scene"):
        graph, headless = (payloads(bag, f"/twin/{topic}") for bag in bags)
        assert graph and graph == headless, topic
    assert list(missing_of(bags[0])) == []
    reports = [json.loads((tmp_path / name / "report.json").read_text()) for name in ("up", "run")]
    for key in ("verdict", "rules", "packages", "series", "film", "wrap"):
        assert reports[0][key] == reports[1][key], key
    torn_s = reports[0]["film"]["torn_s"]
    count, torn = len(torn_s), sum(time_s >= 0.0 for time_s in torn_s)
    assert torn > 0
    scene, judge = judge_bag(bags[0])
    assert (
        report_json(judgement(scene, judge), compact=True).encode()
        in payloads(bags[0], "/twin/eumos/report")[0]
    )
    # Triangles in the sled's frame, first all of them, at the end without the torn ones.
    assert {(kind, frame) for kind, frame, _, _ in seen} == {(11, "sled")}
    assert all(triangles == colours for _, _, triangles, colours in seen)
    assert (seen[0][2], seen[-1][2]) == (count, count - torn)


def test_film_is_waited_for_where_there_is_one() -> None:
    wrapped, bare = validate_scene(TORN), validate_scene({**TORN, "wrap": None})

    def waits(scene: Scene, *, bag: Path | None = None) -> str:
        nodes = dict(Supervisor(scene, "fast", bag, guests=1).nodes_needed(Path("scene.json")))
        return str(nodes["physics_node"]["readers"])

    # The validator and the guest, and the recorder where there is one.
    assert "wrap/strain=2" in waits(wrapped).split(",")
    assert "wrap/strain=3" in waits(wrapped, bag=Path("bag")).split(",")
    assert "wrap" not in waits(bare) and "wrap" not in waits(bare, bag=Path("bag"))
