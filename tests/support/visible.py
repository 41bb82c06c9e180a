"""How much of a box a crop shows, one box at a time: what the engine works out over arrays."""

from jrdb_avr.schema.panorama import CROP, Box, crop_left, to_crop


def visible_share(box: Box, angle_deg: float) -> float:
    """Share, [0, 1], of the box's width that the crop at `angle_deg` shows. A box without width: 0."""
    if not box.w > 0:
        return 0.0
    seen = to_crop(box, crop_left(angle_deg))
    return max(0.0, min(seen.x + seen.w, float(CROP)) - max(seen.x, 0.0)) / box.w
