"""SI values and the DBC's kilopascal convert both ways."""

from __future__ import annotations

import pytest

from firmware_protocol.messages import axis_signals, axis_values, four_signals, four_values


def test_pressures_convert_both_ways() -> None:
    signals = four_signals("Pressure", (0.0, 1e3, 2e3, -500.0), 1000.0)
    assert signals == {"Pressure0": 0.0, "Pressure1": 1.0, "Pressure2": 2.0, "Pressure3": -0.5}
    assert four_values("Pressure", signals, 1000.0) == (0.0, 1e3, 2e3, -500.0)
    with pytest.raises(ValueError, match="3 values for 4 chambers"):
        four_signals("Pressure", (0.0, 0.0, 0.0))


def test_axes_convert_both_ways() -> None:
    assert axis_values(axis_signals((1.0, 2.0, 3.0))) == (1.0, 2.0, 3.0)
    with pytest.raises(ValueError, match="values to unpack"):
        axis_signals((1.0, 2.0))
