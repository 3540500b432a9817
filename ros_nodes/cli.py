"""The command line: ``pallet-twin``."""

import json
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Literal

import typer

from config.errors import PalletTwinError, RefusedInput
from ros_nodes import output
from ros_nodes.campaign import campaign, scaling, verify
from ros_nodes.campaign_statistics import statistics
from ros_nodes.evaluate import evaluate, require_model
from ros_nodes.predict import predict
from ros_nodes.rate import rate
from ros_nodes.train import train

app = typer.Typer(
    name="pallet-twin",
    help="Digital twin of the sled bench that tests palletised loads to EUMOS 40509.\n\n"
    "Start with: pallet-twin run eur_fields_05g",
    epilog="Exit codes: 0 it ran, whatever the verdict; 2 refused input; 3 a monitor ended it, a node died or the disk "
    "is full; 4 --require was not met; 130 interrupted.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

NOT_WRITTEN = 3

SceneArgument = Annotated[
    str,
    typer.Argument(
        metavar="SCENE",
        help="A scene file, a palletising file (then tested at 0.5 g), or a shipped scene's name.",
    ),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Override a value, e.g. sled.level_g=0.6. May be repeated."
    ),
]
OutOption = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Folder for report and bag. Default: runs/NAME, numbered when taken."),
]
OverwriteOption = Annotated[bool, typer.Option("--overwrite", help="Replace an earlier test in --out.")]
EstimateOption = Annotated[
    bool,
    typer.Option(
        "--estimate/--no-estimate", help="Run the test once more at twice the step for an error estimate."
    ),
]
PageOption = Annotated[
    bool, typer.Option("--page/--no-page", help="Write report.html; its figures take about half a second.")
]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print the result as one JSON object on standard output.")
]
RequireOption = Annotated[
    Literal["pass"] | None,
    typer.Option("--require", metavar="pass", help="Exit with 4 unless this is the verdict."),
]


@app.command()
def run(
    scene: SceneArgument,
    out: OutOption = None,
    set_: SetOption = None,
    bag: Annotated[bool, typer.Option("--bag/--no-bag", help="Record an MCAP bag.")] = True,
    estimate: EstimateOption = True,
    cross_check: Annotated[
        bool,
        typer.Option("--cross-check", help="Run it on the other engine too, and say whether the two agree."),
    ] = False,
    page: PageOption = True,
    video: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Where the camera's video goes, an .mp4. Default: OUT/video.mp4, with a camera.",
        ),
    ] = None,
    overwrite: OverwriteOption = False,
    require: RequireOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run one test in one process: report.json, report.html and a bag.

    Examples: `pallet-twin run eur_columns --set sled.level_g=0.3`, `pallet-twin run my_load.xml --out out/my_load`.
    """
    from recordings.recorded_sled import load_scene
    from ros_nodes.one_test import make_folder, run_headless
    from sim_core.integrity import require_integrity
    from sim_core.tolerance import require_estimate

    loaded = load_scene(scene, set_ or ())
    require_integrity(loaded)
    require_estimate(loaded, estimate)
    if cross_check and find_spec("mujoco") is None:
        raise RefusedInput("--cross-check", "mujoco", "is not installed: pip install 'pallet-twin[mujoco]'")
    where = make_folder(loaded, out, overwrite=overwrite, with_bag=bag, with_page=page, video=video)
    with output.progress(loaded, quiet=as_json) as on_progress:
        outcome = run_headless(
            loaded, where, with_estimate=estimate, cross_check=cross_check, on_progress=on_progress
        )
    output.finish(outcome, as_json=as_json, require=require)


@app.command()
def up(
    scene: SceneArgument,
    pace: Annotated[
        Literal["fast", "real"],
        typer.Option(help="fast: as the physics acknowledges; real: on the wall clock."),
    ] = "fast",
    out: OutOption = None,
    record: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where to record the bag. Default: OUT/bag.")
    ] = None,
    no_record: Annotated[bool, typer.Option("--no-record", help="Start no recorder.")] = False,
    split_mb: Annotated[
        int, typer.Option(min=0, metavar="MB", help="Begin a new file of the bag after so many MB; 0: never.")
    ] = 0,
    split_s: Annotated[
        float,
        typer.Option(
            min=0.0, metavar="S", help="Begin a new file after so many simulated seconds; 0: never."
        ),
    ] = 0.0,
    set_: SetOption = None,
    estimate: EstimateOption = True,
    page: PageOption = True,
    bench: Annotated[
        bool,
        typer.Option(
            "--bench",
            help="Drive it by /machine/sled/accelerometer, while the machine moves, and tell what differs from"
            " /machine/vision/displacement where that is published.",
        ),
    ] = False,
    view: Annotated[
        bool, typer.Option("--view", help="Show it live on a page, at http://127.0.0.1:9090 while it runs.")
    ] = False,
    pictures: Annotated[
        Path | None,
        typer.Option(
            metavar="BAG", help="The camera shows the pictures of this bag of the same test, and draws none."
        ),
    ] = None,
    classify: Annotated[
        Path | None,
        typer.Option(
            metavar="MODEL",
            help="Have a trained classifier, such as compact, guess from the pictures while it runs.",
        ),
    ] = None,
    overwrite: OverwriteOption = False,
    discovery: Annotated[
        Literal["localhost", "subnet"],
        typer.Option(help="Who may see the nodes: this host alone, or its network too."),
    ] = "localhost",
    guests: Annotated[
        int,
        typer.Option(
            min=0, max=16, help="Readers of your own to wait for on every stream before the first sample."
        ),
    ] = 0,
    require: RequireOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run the same test as a ROS 2 node graph under /twin: sled, physics, validator and recorder.

    While it runs, any ROS 2 tool on this host and ROS_DOMAIN_ID sees the topics.
    """
    from recordings.recorded_sled import load_scene
    from ros_nodes.one_test import make_folder, run_graph
    from sim_core.integrity import require_integrity
    from sim_core.tolerance import require_estimate

    loaded = load_scene(scene, set_ or ())
    require_integrity(loaded)
    require_estimate(loaded, estimate)
    if record is not None and no_record:
        raise RefusedInput("--record", str(record), "contradicts --no-record")
    if view:
        from ros_nodes.viewer_node import require_rerun

        require_rerun()
        print("view    http://127.0.0.1:9090/ while it runs", file=sys.stderr)
    if bench and loaded.solver.tolerance_mm is not None:
        raise RefusedInput(
            "solver.tolerance_mm", loaded.solver.tolerance_mm, "cannot be planned for with --bench"
        )
    if pictures is not None and loaded.camera is None:
        raise RefusedInput("--pictures", str(pictures), "needs a camera in the scene")
    if classify is not None:
        classify = require_model(classify, loaded)
    where = make_folder(loaded, out, overwrite=overwrite, with_bag=not no_record, bag=record, with_page=page)
    with output.progress(loaded, quiet=as_json) as on_progress:
        outcome = run_graph(
            loaded,
            where,
            pace=pace,
            discovery=discovery,
            with_estimate=estimate,
            guests=guests,
            pictures=pictures,
            with_view=view,
            split=(split_mb, split_s),
            bench=bench,
            classify=classify,
            on_progress=on_progress,
        )
    output.finish(outcome, as_json=as_json, require=require)


@app.command()
def check(
    file: Annotated[
        str, typer.Argument(metavar="FILE", help="A scene, a palletising file, a bag, or a shipped scene.")
    ],
    set_: SetOption = None,
    as_json: JsonOption = False,
) -> None:
    """Check a scene, a palletising file or a bag without running anything."""
    from ros_nodes.checks import check_file

    findings, facts = check_file(file, set_ or ())
    output.show_check(findings, facts, as_json=as_json)


@app.command()
def judge(
    bag: Annotated[Path, typer.Argument(metavar="BAG", help="A bag directory or an .mcap file.")],
    require: RequireOption = None,
    as_json: JsonOption = False,
) -> None:
    """Judge a recording again, from the scene and the poses in it."""
    from recordings.judge_bag import judge_bag
    from sim_core.report import judgement, report_json

    scene, judged = judge_bag(bag)
    report = judgement(scene, judged)
    if as_json:
        print(report_json(report))
    else:
        output.show_rules(report)
    output.meet(require, report)


@app.command()
def replay(
    bag: Annotated[Path, typer.Argument(metavar="BAG", help="A bag directory or an .mcap file.")],
    rate: Annotated[
        float, typer.Option(metavar="X", min=0.01, max=1000.0, help="Seconds of the bag a second.")
    ] = 1.0,
    fast: Annotated[bool, typer.Option("--fast", help="As fast as its readers acknowledge.")] = False,
    start: Annotated[
        float, typer.Option(metavar="S", min=0.0, help="Begin so many seconds after the first message.")
    ] = 0.0,
    loop: Annotated[
        int,
        typer.Option(
            metavar="N", min=0, help="Play it so often; 0: until interrupted. /clock jumps back each time."
        ),
    ] = 1,
    namespace: Annotated[str, typer.Option(metavar="TO|FROM:=TO", help="Move the recorded namespace.")] = "",
    topic: Annotated[
        list[str] | None,
        typer.Option(metavar="PATTERN", help="Play only these, e.g. 'sled/*'. May be repeated."),
    ] = None,
    leave_out: Annotated[
        list[str] | None,
        typer.Option(metavar="PATTERN", help="Play all but these, e.g. 'eumos/*'. May be repeated."),
    ] = None,
    judge: Annotated[bool, typer.Option("--judge", help="Have it judged anew, and compare.")] = False,
    pictures: Annotated[bool, typer.Option("--pictures", help="Have it drawn anew, and compare.")] = False,
    guests: Annotated[
        int, typer.Option(min=0, max=16, help="Readers of your own that every stream must have first.")
    ] = 0,
    paused: Annotated[
        bool, typer.Option("--paused", help="Begin halted; services player/pause, player/step.")
    ] = False,
    discovery: Annotated[
        Literal["localhost", "subnet"],
        typer.Option(help="Who may see the nodes: this host alone, or its network too."),
    ] = "localhost",
    as_json: JsonOption = False,
) -> None:
    """Play a recording on its own topics, with /clock.

    Example: `pallet-twin replay runs/eur_columns/bag --judge --fast` gives the verdict that was given live.
    """
    from ros_nodes import replay as playing

    with output.played(quiet=as_json) as on_progress:
        replayed = playing.replay(
            bag,
            rate=None if fast else rate,
            start_s=start,
            loop=loop,
            namespace=namespace,
            topics=topic or (),
            leave_out=leave_out or (),
            judge=judge,
            pictures=pictures,
            guests=guests,
            paused=paused,
            discovery=discovery,
            on_progress=on_progress,
        )
    output.show_replayed(replayed, as_json=as_json)


@app.command()
def recover(
    bag: Annotated[
        Path, typer.Argument(metavar="BAG", help="A bag directory, an .mcap or an .mcap.part file.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Write the new bag there and leave the original as it is."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Make a recording whole that was cut short or damaged, and say what is missing."""
    from recordings.rescue import recover_bag

    output.show_recovery(recover_bag(bag, out), as_json=as_json)


@app.command()
def view(
    bag: Annotated[
        Path | None,
        typer.Argument(metavar="[BAG]", help="A bag directory or an .mcap file; none with --live."),
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="Show what runs under --namespace, test after test.")
    ] = False,
    web: Annotated[
        bool, typer.Option("--web", help="Serve a page for a browser on this host, without a window.")
    ] = False,
    save: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a rerun recording, an .rrd, and show nothing.")
    ] = None,
    namespace: Annotated[str, typer.Option(help="Of the nodes to look at.")] = "/twin",
    data_port: Annotated[
        int, typer.Option(min=0, max=65535, help="Of rerun's data; 0 takes a free one.")
    ] = 9876,
    page_port: Annotated[int, typer.Option(min=0, max=65535, help="Of the page; 0 takes a free one.")] = 9090,
) -> None:
    """Look at a recording, or at a running test, in rerun: load, film, camera, displacement against the limits.

    Example: `pallet-twin view runs/eur_camera/bag --web`. Needs the extra `view`; nothing leaves this host.
    """
    from ros_nodes import view as viewing

    viewing.view(
        bag,
        live=live,
        namespace=namespace,
        web=web,
        save=save,
        data_port=data_port,
        page_port=page_port,
        on_page=lambda url: print(f"view    {url}", flush=True),
    )
    if save is not None:
        print(f"view    {save}")


SceneOption = Annotated[
    str | None,
    typer.Option(
        "--scene",
        metavar="SCENE",
        help="The load that was tested, as for run. Default: the scene in the bag.",
    ),
]
SledTopicOption = Annotated[
    str,
    typer.Option("--sled", metavar="TOPIC", help="Of the sled's accelerometer. Default: the bag's only one."),
]
DisplacementOption = Annotated[
    str,
    typer.Option(
        "--displacement",
        metavar="TOPIC",
        help="What was measured. Default: packages/poses, else vision/displacement.",
    ),
]


@app.command()
def calibrate(
    bag: Annotated[Path, typer.Argument(metavar="BAG", help="A recording of a bench, or of the twin.")],
    scene: SceneOption = None,
    fit: Annotated[
        list[str] | None,
        typer.Option(
            "--fit",
            metavar="KEY",
            help="friction:A/B of two surfaces, force_fields.tension, wrap.wrap_force_n and the like. May be repeated."
            " Default: what is usual for the scene.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The scene with the fitted values. Default: NAME-fitted.json."),
    ] = None,
    sled: SledTopicOption = "",
    displacement: DisplacementOption = "",
    as_json: JsonOption = False,
) -> None:
    """Fit friction, force fields or film to the displacement in a recording, and write the scene with these values.

    Example: `pallet-twin calibrate bench_bag --scene my_load.json --fit friction:cardboard/wood`.
    """
    from recordings.calibrate import calibrate_bag, calibration_lines, write_calibrated
    from ros_nodes.benching import scene_for

    wanted = scene_for(bag, scene)
    file = out if out is not None else Path(f"{wanted.name}-fitted.json")
    if file.exists() and out is None:
        raise RefusedInput("--out", str(file), "exists: name a file")
    with output.fitting(quiet=as_json) as on_progress:
        calibrated = calibrate_bag(
            bag, wanted, fit=fit or (), sled=sled, displacement=displacement, on_progress=on_progress
        )
    write_calibrated(file, calibrated)
    output.show_lines(
        calibration_lines(calibrated), {**calibrated.entry(), "scene": str(file)}, as_json=as_json
    )
    if not as_json:
        print(f"scene   {file}")


@app.command()
def compare(
    bag: Annotated[Path, typer.Argument(metavar="BAG", help="A recording of a bench, or of the twin.")],
    scene: SceneOption = None,
    sled: SledTopicOption = "",
    displacement: DisplacementOption = "",
    as_json: JsonOption = False,
) -> None:
    """Drive the twin by the accelerometer in a recording, and say how far its load is from the measured one."""
    from recordings.calibrate import compare_bag
    from ros_nodes.benching import difference_lines, scene_for

    told = compare_bag(bag, scene_for(bag, scene), sled=sled, displacement=displacement)
    output.show_lines(difference_lines(told), told, as_json=as_json)


@app.command()
def measure(
    bag: Annotated[
        Path, typer.Argument(metavar="BAG", help="A bag directory or an .mcap file with pictures.")
    ],
    video: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write an .mp4 with the displacement drawn in as red lines."),
    ] = None,
    require: RequireOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure displacement from a recording's pictures alone, beside the truth where the bag has poses.

    Example: `pallet-twin measure runs/eur_camera_markers/bag --video measured.mp4`.
    """
    from recordings.measure_bag import measure_bag

    with output.counter("pictures", quiet=as_json) as count:
        measured = measure_bag(bag, video=video, on_picture=count)
    output.show_measured(measured, video, as_json=as_json)
    output.meet(require, measured.entry)


@app.command()
def render(
    bag: Annotated[Path, typer.Argument(metavar="BAG", help="A bag directory or an .mcap file.")],
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for bag and video. Default: runs/NAME-render.")
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="Of the camera, e.g. camera.distance_m=6. May be repeated."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Draw the pictures of a recording anew, from the same camera or another, without simulating it again.

    Example: `pallet-twin render runs/eur_camera/bag --set camera.film=strain --set camera.distance_m=6`.
    """
    from ros_nodes.render import render_bag

    with output.counter("pictures", quiet=as_json) as count:
        drawn = render_bag(bag, out, set_ or (), on_picture=count)
    output.show_drawn(drawn, as_json=as_json)


@app.command()
def sight(
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for table and page; resumed if it exists.")
    ] = Path("runs/sight"),
    quick: Annotated[bool, typer.Option("--quick", help="Two loads a look, a few minutes.")] = False,
    no_cost: Annotated[bool, typer.Option("--no-cost", help="Do not time the drawing of pictures.")] = False,
    only_cost: Annotated[
        bool,
        typer.Option("--only-cost", help="Only time it, a minute; the page has the tests that DIR holds."),
    ] = False,
    workers: Annotated[
        int, typer.Option(min=1, max=64, help="Tests at once; measuring them then takes longer each.")
    ] = 1,
) -> None:
    """Draw and measure many loads, with markers, without and behind film, and hold the measurement against the poses.

    Says how far off it is, how often its uncertainty covers that, whether its verdict is the judge's, and what a
    picture costs: with film and shadows and without, at three sizes. DIR/sight.html shows it all. Tests that DIR
    holds are not run again; the cost is measured anew each time, and needs a quiet machine.

    Examples: `pallet-twin sight --quick --out /tmp/sight`, `pallet-twin sight --only-cost`.
    """
    from sim_core.camera.cost import measure_cost, write_cost
    from sim_core.vision.sight_page import write_sight_page
    from sim_core.vision.sweep import rows_on_disk, run_sight, summaries

    if no_cost and only_cost:
        raise RefusedInput("--only-cost", "--no-cost", "one of the two at most")
    if only_cost:
        out.mkdir(parents=True, exist_ok=True)
        rows = rows_on_disk(out)
    else:
        with output.counter("measured from pictures", quiet=False) as count:
            rows, _ = run_sight(out, quick=quick, workers=workers, on_progress=count)
        output.show_sight(summaries(rows))
    cost = None
    if not no_cost:
        with output.counter("cost of a picture", quiet=False) as count:
            cost = measure_cost(on_progress=count)
        write_cost(cost, out / "sight_cost.json")
        output.show_picture_cost(cost)
    page = write_sight_page(out, rows, cost)
    print(f"page    {page}")
    if not only_cost:
        print(f"table   {out / 'sight.csv'}")


@app.command()
def sheet(
    scenes: Annotated[
        list[str] | None,
        typer.Argument(metavar="[SCENE]...", help="Scenes; without one, all shipped scenes."),
    ] = None,
    out: Annotated[Path, typer.Option(metavar="FILE", help="The picture, a .jpg or .png.")] = Path(
        "runs/sheet.jpg"
    ),
    set_: SetOption = None,
    width: Annotated[int, typer.Option(min=64, max=1920, help="Of one picture [px].")] = 480,
) -> None:
    """Put tests on one contact sheet: each at its start, at its largest displacement and at its end.

    A scene without a camera gets the usual one.
    """
    from config.scene_file import shipped_scenes
    from ros_nodes.sheet import write_sheet

    with output.counter("contact sheet", quiet=False) as count:
        write_sheet(scenes or shipped_scenes(), out, set_ or (), width_px=width, on_row=count)
    print(f"sheet   {out}")


app.command()(rate)


@app.command()
def accuracy(
    scene: Annotated[
        str | None,
        typer.Argument(metavar="[SCENE]", help="Measure this scene; without it, the reference suite."),
    ] = None,
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for tables, figures and page; resumed if it exists.")
    ] = Path("runs/accuracy"),
    set_: SetOption = None,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer settings and cases, about a minute.")] = False,
) -> None:
    """Measure error against run time, over time steps, iterations and engines.

    The reference suite is held against closed forms and independent solutions, a scene of yours against its own
    refined runs. Rows that the folder already holds are not run again.
    """
    from recordings.recorded_sled import load_scene
    from sim_core.accuracy import run_accuracy

    loaded = load_scene(scene, set_ or ()) if scene is not None else None
    with output.counter("error against run time", quiet=False) as count:
        run_accuracy(out, scene=loaded, quick=quick, on_progress=count)
    print(f"page    {out / 'accuracy.html'}")
    print(f"table   {out / 'accuracy.csv'}")


@app.command()
def agreement(
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for table and figure; resumed if it exists.")
    ] = Path("runs/agreement"),
    quick: Annotated[bool, typer.Option("--quick", help="A handful of scenes.")] = False,
) -> None:
    """Run a grid of layouts, levels and frictions on both engines, and say how often their verdicts agree.

    Rows that the folder already holds are not run again. Needs the extra `mujoco`.
    """
    from sim_core.accuracy.agreement import run_agreement

    if find_spec("mujoco") is None:
        raise RefusedInput("agreement", "mujoco", "is not installed: pip install 'pallet-twin[mujoco]'")
    with output.counter("engine agreement", quiet=False) as count:
        run_agreement(out, quick=quick, on_progress=count)
    print(f"table   {out / 'agreement.csv'}")
    print(f"figure  {out / 'agreement.svg'}")


@app.command()
def parts(
    scene: SceneArgument,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the tables.")] = Path("runs/parts"),
    set_: SetOption = None,
    repeats: Annotated[int, typer.Option(min=1, max=50, help="Timed runs a row.")] = 5,
    only: Annotated[
        list[str] | None, typer.Option(metavar="ROW", help="Only these rows. May be repeated.")
    ] = None,
) -> None:
    """Measure what each optional part of a test costs: time, memory, modules, nodes and topics, with it and without.

    Every run is a process of its own, taking turns, so that other work on the machine hits all rows alike.
    """
    from recordings.recorded_sled import load_scene
    from ros_nodes.parts_cost import measure_parts

    loaded = load_scene(scene, set_ or ())
    with output.counter("cost of the parts", quiet=False) as count:
        measure_parts(loaded, out, repeats=repeats, only=only or (), on_progress=count)
    print(f"table   {out / 'parts.md'}")


@app.command()
def stress(
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write the table here: JSON, CSV and a page.")
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(metavar="ROW", help="Run only these rows; * stands for anything. May be repeated."),
    ] = None,
    engine: Annotated[Literal["bullet", "mujoco", "both"], typer.Option(help="Engine to try.")] = "bullet",
    as_json: JsonOption = False,
) -> None:
    """Run the stability table: stiff and extreme cases, each right, refused, ended by a monitor, or wrong.

    Example: `pallet-twin stress --only 'mass_ratio*'`. The whole table takes about a minute an engine.
    """
    from sim_core.stress import run_stress

    engines = ("bullet", "mujoco") if engine == "both" else (engine,)
    with output.counter("stability table", quiet=as_json) as count:
        results = run_stress(out, only=only or (), engines=engines, on_progress=count)
    output.show_stress(results, out, as_json=as_json)


@app.command()
def schema(
    campaign: Annotated[bool, typer.Option("--campaign", help="That of campaign files instead.")] = False,
) -> None:
    """Print the scene's JSON Schema."""
    from config.campaign import Campaign
    from config.scene import Scene

    print(json.dumps((Campaign if campaign else Scene).model_json_schema(), indent=1))


@app.command()
def scenes() -> None:
    """List the shipped scenes."""
    from config.scene_file import find_scene, shipped_scenes

    for name in shipped_scenes():
        raw = json.loads(find_scene(name).read_text(encoding="utf-8"))
        print(f"{name:22} {raw.get('description', '')}")


app.command()(campaign)
app.command()(statistics)
app.command()(verify)
app.command()(scaling)
app.command()(train)
app.command()(evaluate)
app.command()(predict)


@app.callback(invoke_without_command=True)
def _options(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    if version:
        from importlib.metadata import version as version_of

        print(version_of("pallet-twin"))
        raise typer.Exit


def main() -> None:
    """Runs the command line; every error of the family becomes one line and one exit code, here."""
    try:
        app()
    except PalletTwinError as error:
        print(f"pallet-twin: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    except OSError as error:
        # Input files are opened by readers that refuse them; what is left is output that cannot be written.
        print(f"pallet-twin: {error.filename or 'output'}: {error.strerror}", file=sys.stderr)
        sys.exit(NOT_WRITTEN)


if __name__ == "__main__":
    from ros_nodes.entry import main as entry

    entry()
