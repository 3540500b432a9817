"""What ``pallet-twin view`` does: a recording or a running test, in a window, as a page or into a file."""

import time
from collections.abc import Callable
from pathlib import Path

from config.errors import RefusedInput
from ros_nodes.viewer_node import DATA_PORT, PAGE_PORT, ViewerNode, require_rerun

WRITTEN = ".rrd"
NODE = "live_view"
"""What the live view is called, so that a supervisor's own viewer can run beside it."""


def view(
    bag: Path | None,
    *,
    live: bool = False,
    namespace: str = "/twin",
    web: bool = False,
    save: Path | None = None,
    data_port: int = DATA_PORT,
    page_port: int = PAGE_PORT,
    on_page: Callable[[str], None] | None = None,
) -> None:
    """Shows a bag, or what runs; returns when a file is written, the window closed, or an interrupt comes.

    Everything listens on 127.0.0.1 alone.

    Args:
        bag: the recording, or None for a live view.
        live: watch the test that runs on this host and ROS domain, or will.
        namespace: where its topics stand.
        web: serve a page in place of opening a window.
        save: write a file for rerun: of a bag in place of showing it, live beside it.
        data_port: where rerun's data are served; 0 takes a free port.
        page_port: where the page is; 0 takes a free port.
        on_page: called with the page's address.

    Raises:
        RefusedInput: rerun is not installed, a port is taken, there is no display for a window, the file exists, or
            not exactly one of bag and live is given.
        BrokenRecording: the bag is damaged, or holds no scene or no poses.
        Interrupted: the user ended it.
    """
    if (bag is None) != live:
        raise RefusedInput("view", str(bag), "needs a BAG or --live, not both")
    require_rerun()
    if save is not None and (save.suffix != WRITTEN or save.exists() or not save.absolute().parent.is_dir()):
        raise RefusedInput("--save", str(save), f"must be a new {WRITTEN} file in a folder that exists")
    if bag is None:
        _view_live(namespace, web, save, data_port, page_port)
    elif save is not None:
        from recordings.rerun_page import save_bag

        save_bag(bag, save)
    else:
        _show_bag(bag, web, data_port, page_port, on_page)


def _show_bag(
    bag: Path, web: bool, data_port: int, page_port: int, on_page: Callable[[str], None] | None
) -> None:
    from recordings.rerun_page import DataServer, ViewerPage, open_window, require_display
    from recordings.rerun_view import view_bag

    if not web:
        require_display()
    server = DataServer(port=data_port)
    try:
        recording = server.recording(bag.absolute().name)
        view_bag(bag, recording)
        recording.flush()
        if not web:
            open_window(server).wait()
            return
        page = ViewerPage(server, port=page_port)
        if on_page is not None:
            on_page(page.url)
        try:
            while True:
                time.sleep(3600.0)
        finally:
            page.close()
    finally:
        server.close()


def _view_live(namespace: str, web: bool, save: Path | None, data_port: int, page_port: int) -> None:
    from recordings.rerun_page import require_display
    from ros_nodes.node_process import run_node
    from ros_nodes.supervisor import configure_middleware

    if not web:
        require_display()
    configure_middleware("localhost")
    parameters = {
        "data_port": data_port, "page_port": page_port, "window": str(not web).lower(), "autostart": "true",
        **({"save": f"'{save.absolute()}'"} if save is not None else {}),
    }  # fmt: skip
    arguments = ["--ros-args", "-r", f"__ns:={namespace}", "-r", f"__node:={NODE}"]
    for name, value in parameters.items():
        arguments += ["-p", f"{name}:={value}"]
    run_node(ViewerNode, arguments)
