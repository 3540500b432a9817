"""Layers of a load: numbering them by height, and keeping, turning or mirroring some of them."""

from bisect import bisect_left, bisect_right
from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import combinations

from config.errors import RefusedInput
from config.package import Package
from config.readers.pallet import Bounds, PatternPallet, bounds

LEVEL_TOLERANCE_M = 0.001
OVERLAP_TOLERANCE_M = 0.0005


def number_layers(packages: Sequence[Package]) -> tuple[Package, ...]:
    """Give each package the number of its layer, from 1 upwards.

    A layer is the packages whose bottoms stand at one height, to within 1 mm. In a mixed load a tall package
    belongs to the layer in which it stands; whatever bears a package then has a lower number than it, so the
    lowest n layers stand by themselves. An interlayer gets the number of the layer below it; one that lies
    on the deck gets None.
    """
    levels: list[float] = []
    for bottom in sorted(bounds(package).z_min for package in packages if package.kind == "package"):
        if not levels or bottom > levels[-1] + LEVEL_TOLERANCE_M:
            levels.append(bottom)

    def layer_of(package: Package) -> int | None:
        bottom = bounds(package).z_min
        if package.kind == "package":
            return bisect_right(levels, bottom)
        return bisect_left(levels, bottom - LEVEL_TOLERANCE_M / 2) or None

    return tuple(package.model_copy(update={"layer": layer_of(package)}) for package in packages)


def name_by_layer(packages: Sequence[Package]) -> tuple[Package, ...]:
    """Name numbered packages ``L2-05`` (layer 2, fifth in file order) and interlayers ``I2-1``."""
    counts: dict[str, int] = {}
    named = []
    for package in packages:
        prefix = f"{'I' if package.kind == 'interlayer' else 'L'}{package.layer or 0}"
        counts[prefix] = counts.get(prefix, 0) + 1
        digits = 1 if package.kind == "interlayer" else 2
        named.append(package.model_copy(update={"id": f"{prefix}-{counts[prefix]:0{digits}d}"}))
    return tuple(named)


def vary_layers(
    pallet: PatternPallet,
    *,
    layers: int | None = None,
    rotate_layers: Sequence[int] = (),
    mirror_layers: Sequence[int] = (),
) -> PatternPallet:
    """Keep the lowest layers of a load, and turn or mirror some of them.

    Args:
        pallet: the load as its file has it.
        layers: how many package layers to keep, from below; None keeps the load as it is. An interlayer on
            top of the last kept layer goes too; one on the deck stays.
        rotate_layers: layers whose packages turn by 180 degrees about the pallet's centre.
        mirror_layers: layers whose packages are mirrored, y to -y. Interlayers stay where they are.

    Raises:
        RefusedInput: a layer that is not there or named twice; a change that would make two packages overlap
            or leave one without anything below it. Both can happen in mixed loads only.
    """
    count = max((package.layer or 0 for package in pallet.packages if package.kind == "package"), default=0)
    if layers is not None and not 1 <= layers <= count:
        raise RefusedInput("layers", layers, f"1 to {count}, the layers in the file")
    kept_count = count if layers is None else layers
    for field, chosen in (("rotate_layers", rotate_layers), ("mirror_layers", mirror_layers)):
        if len(set(chosen)) < len(chosen) or not all(1 <= layer <= kept_count for layer in chosen):
            raise RefusedInput(field, list(chosen), f"layers 1 to {kept_count}, each once")

    kept = pallet.packages if layers is None else tuple(p for p in pallet.packages if _is_kept(p, layers))
    changed = tuple(_moved(package, rotate_layers, mirror_layers) for package in kept)
    _check_move(kept, changed, rotate_layers, mirror_layers)

    notes = list(pallet.notes)
    if layers is not None and layers < count:
        notes.append(f"kept the lowest {layers} of {count} layers")
    for verb, chosen in (("turned by 180 deg", rotate_layers), ("mirrored", mirror_layers)):
        if chosen:
            notes.append(f"{verb}: layer {', '.join(str(layer) for layer in sorted(chosen))}")
    return replace(pallet, packages=changed, notes=tuple(notes))


def _is_kept(package: Package, layers: int) -> bool:
    if package.layer is None:
        return True
    return package.layer <= layers if package.kind == "package" else package.layer < layers


def _moved(package: Package, rotate_layers: Collection[int], mirror_layers: Collection[int]) -> Package:
    if package.kind == "interlayer":
        return package
    (x, y, z), yaw = package.position_m, package.yaw_deg
    if package.layer in rotate_layers:
        x, y, yaw = -x, -y, yaw + 180.0
    if package.layer in mirror_layers:
        y, yaw = -y, -yaw
    return package.model_copy(update={"position_m": (x + 0.0, y + 0.0, z), "yaw_deg": yaw % 360.0})


def _check_move(
    before: Sequence[Package], after: Sequence[Package], rotated: Collection[int], mirrored: Collection[int]
) -> None:
    if not rotated and not mirrored:
        return
    # Interlayers are a group of their own, numbered 0: they stay, whatever layer they lie on.
    groups: dict[int, list[int]] = {}
    for index, package in enumerate(before):
        groups.setdefault(package.layer or 0 if package.kind == "package" else 0, []).append(index)
    old = [bounds(package) for package in before]
    new = [bounds(package) for package in after]

    def motion(layer: int) -> tuple[bool, bool]:
        return layer in rotated, layer in mirrored

    def refuse(layer: int, reason: str) -> RefusedInput:
        return RefusedInput("rotate_layers" if layer in rotated else "mirror_layers", layer, reason)

    for low, high in combinations(sorted(groups), 2):
        if motion(low) == motion(high) or not _share_heights(groups[low], groups[high], new):
            continue
        for i in groups[low]:
            for j in groups[high]:
                depth = new[i].overlap(new[j])
                if depth > OVERLAP_TOLERANCE_M and depth > old[i].overlap(old[j]) + OVERLAP_TOLERANCE_M:
                    layer = high if any(motion(high)) else low
                    pair = f"{after[i].id} and {after[j].id}"
                    raise refuse(
                        layer, f"{pair} would overlap by {depth * 1000:.0f} mm; leave this layer as it is"
                    )

    rested, rests = _resting(old), _resting(new)
    for index, package in enumerate(after):
        if rested[index] and not rests[index]:
            moved = [n for n in (package.layer or 0, *rotated, *mirrored) if any(motion(n))]
            raise refuse(moved[0], f"{package.id} would rest on nothing; leave this layer as it is")


def _share_heights(first: Sequence[int], second: Sequence[int], boxes: Sequence[Bounds]) -> bool:
    top = min(max(boxes[i].z_max for i in first), max(boxes[j].z_max for j in second))
    bottom = max(min(boxes[i].z_min for i in first), min(boxes[j].z_min for j in second))
    return top - bottom > OVERLAP_TOLERANCE_M


def _resting(boxes: Sequence[Bounds]) -> list[bool]:
    """Whether each box stands on the deck or on the top of another, to within the level tolerance."""
    by_top = sorted(boxes, key=lambda box: box.z_max)
    tops = [box.z_max for box in by_top]

    def rests(box: Bounds) -> bool:
        if abs(box.z_min) <= LEVEL_TOLERANCE_M:
            return True
        first = bisect_left(tops, box.z_min - LEVEL_TOLERANCE_M)
        last = bisect_right(tops, box.z_min + LEVEL_TOLERANCE_M)
        return any(box.footprint_overlap(below) > LEVEL_TOLERANCE_M for below in by_top[first:last])

    return [rests(box) for box in boxes]
