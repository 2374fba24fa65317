"""SI values to the DBC's units and back, where they differ (kilopascal), and indexed signals as tuples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

CHAMBERS = 4
PASCAL_PER_KILOPASCAL = 1000.0
PASCAL_PER_HECTOPASCAL = 100.0  # 1 hPa = 0.1 kPa, the bus's step of a chamber's pressure

FourValues = tuple[float, float, float, float]
ThreeValues = tuple[float, float, float]


def four_signals(prefix: str, values: Sequence[float], divisor: float = 1.0) -> dict[str, float]:
    """`{prefix}0` to `{prefix}3` for the values of the four chambers, divided by `divisor`."""
    if len(values) != CHAMBERS:
        raise ValueError(f"{prefix}: {len(values)} values for {CHAMBERS} chambers")
    return {f"{prefix}{chamber}": values[chamber] / divisor for chamber in range(CHAMBERS)}


def four_values(prefix: str, signals: Mapping[str, float], factor: float = 1.0) -> FourValues:
    """The four chambers' values of `{prefix}0` to `{prefix}3`, times `factor`."""
    return (
        signals[f"{prefix}0"] * factor,
        signals[f"{prefix}1"] * factor,
        signals[f"{prefix}2"] * factor,
        signals[f"{prefix}3"] * factor,
    )


def axis_signals(values: Sequence[float]) -> dict[str, float]:
    """X, Y, Z of an IMU message."""
    x, y, z = values
    return {"X": x, "Y": y, "Z": z}


def axis_values(signals: Mapping[str, float]) -> ThreeValues:
    """X, Y, Z of an IMU message as a tuple."""
    return signals["X"], signals["Y"], signals["Z"]
