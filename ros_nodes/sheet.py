"""A contact sheet of tests as one picture file."""

from collections.abc import Callable, Sequence
from pathlib import Path

from config.camera import Camera
from config.errors import RefusedInput


def write_sheet(
    names: Sequence[str],
    path: Path,
    overrides: Sequence[str],
    *,
    width_px: int,
    on_row: Callable[[int, int, object], None] | None = None,
) -> None:
    """Runs scenes and puts their pictures on one sheet.

    Args:
        names: scene files or names of shipped scenes.
        path: file to write, ``.jpg`` or ``.png``.
        overrides: ``key=value`` texts for each of them.
        width_px: of one picture; its height is 9/16 of that.
        on_row: called with tests done, how many there are, and the last one's name.

    Raises:
        RefusedInput: a scene, an override or the file cannot be used.
    """
    import cv2

    from recordings.recorded_sled import load_scene
    from sim_core.camera.contact_sheet import contact_sheet, sheet_row
    from sim_core.work_precision import with_setting

    if path.suffix.lower() not in (".jpg", ".png"):
        raise RefusedInput("--out", str(path), "must end in .jpg or .png")
    rows = []
    for number, name in enumerate(names, start=1):
        scene = with_setting(load_scene(name, overrides))[0]
        camera = scene.camera or Camera()
        size = {"width_px": width_px // 2 * 2, "height_px": round(width_px * 9 / 32) * 2}
        rows.append(sheet_row(scene.model_copy(update={"camera": camera.model_copy(update=size)})))
        if on_row is not None:
            on_row(number, len(names), name)
    encoded = cv2.imencode(path.suffix.lower(), contact_sheet(rows)[:, :, ::-1])[1]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(encoded.tobytes())
    except OSError as error:
        raise RefusedInput("--out", str(path), error.strerror or "cannot be written") from None
