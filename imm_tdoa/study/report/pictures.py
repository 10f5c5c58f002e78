"""All pictures of a study, drawn one at a time."""

from __future__ import annotations

from collections.abc import Iterator

import xarray as xr

from imm_tdoa.study.report import draw_map, draw_rank, draw_time, lessons
from imm_tdoa.study.report.paper import Picture


def whole(data: xr.Dataset) -> Iterator[Picture]:
    """Yield the pictures of the whole study: maps and lines over what was swept."""
    several = data.sizes["bank"] > 1
    for base, members in lessons.groups(data).items():
        changing = lessons.changing(data, members)
        numeric = lessons.swept(data, "scenario", members)
        if len(changing) > 1 and several:
            yield draw_map.winners(data, base, members, changing)
        if len(changing) == 1 and numeric:
            for picture in (
                draw_map.lines(data, base, members, numeric[0]),
                draw_rank.criteria(data, base, members, numeric[0]),
            ):
                if picture is not None:
                    yield picture
    tuning = draw_map.tuning(data)
    if tuning is not None:
        yield tuning


def of_scenario(data: xr.Dataset, i: int) -> Iterator[Picture]:
    """Yield the pictures of one scenario: ranking, errors and mode probabilities over time."""
    for draw in (draw_rank.ranking, draw_time.errors, draw_time.ribbons):
        picture = draw(data, i)
        if picture is not None:
            yield picture
