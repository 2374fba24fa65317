"""What both calibrations, of holds and of recordings, take for granted, in words; robot files list it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from calib.calibration import DENSITY_KG_M3, PRESSURE_RESERVE, largest_allowed_Pa
from softbot.cross_section import DEFAULT_CENTROID_RATIO, DEFAULT_CHAMBER_AREA_RATIO


def section_assumed(centroid_fitted: bool) -> list[str]:
    """Of the section, which no table tells and no option gives."""
    found = [f"each chamber has {DEFAULT_CHAMBER_AREA_RATIO:g} of the section's area (no drawing of the section)"]
    if not centroid_fitted:
        found.append(f"the chambers' centroids lie at {DEFAULT_CENTROID_RATIO:g} of the radius")
    return found


def gains_assumed(still: list[int]) -> list[str]:
    """Of chambers that were never driven."""
    return [f"gain 1 of chamber{'s' if len(still) > 1 else ''} {listed(still)}: never driven"] if still else []


def one_gain_assumed(groups: Iterable[Sequence[int]]) -> list[str]:
    """Of chambers that a recording always drove alike; groups: chambers with one gain each."""
    alike = (sorted(group) for group in groups if len(group) > 1)
    return [f"one gain for chambers {listed(group)}: they always had the same pressure" for group in alike]


def limit_assumed(largest_Pa: float) -> str:
    """Of the largest pressure the robot may see."""
    allowed_kPa = largest_allowed_Pa(largest_Pa) / 1e3
    return f"largest pressure {allowed_kPa:g} kPa: assumed, {PRESSURE_RESERVE:g} times the table's highest, rounded up"


def mass_assumed(mass_kg: float | None) -> str:
    """Of the mass, where none is given."""
    if mass_kg is not None:
        return f"mass {mass_kg:g} kg: given"
    return f"mass from a density of {DENSITY_KG_M3:g} kg/m3 and the wall's area"


def never_driven(still: list[int]) -> list[str]:
    """The warning of such chambers."""
    return [f"chamber{'s' if len(still) > 1 else ''} {listed(still)} never driven: gain 1 assumed"] if still else []


def listed(numbers: list[int]) -> str:
    """Numbers in words: "1, 2 and 3"."""
    return (
        " and ".join(map(str, numbers))
        if len(numbers) < 3
        else f"{', '.join(map(str, numbers[:-1]))} and {numbers[-1]}"
    )
