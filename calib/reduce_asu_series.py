"""Reduce the four-chamber arm's trials to the shipped recording.

Command: `python -m calib.reduce_asu_series SOURCE_DIR OUT.csv`.

Source and chambers as in `calib.reduce_asu`. Taken are the trials that drive one chamber of the link (`apr4_1 … 4`),
every third row (20 Hz). The bend is the absolute rotation of rb2 against rb1, as a vector: where a trial starts bent,
the link has kept some of its last load, and the calibration makes use of that. Rows whose quaternions are flagged
have no bend.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib.reduce_asu import CHANNEL_OF_CHAMBER, PSI_KPA, read_rows_of, relative_rotation
from softbot.errors import InputError, SoftbotError

TRIALS = ("apr4_1", "apr4_2", "apr4_3", "apr4_4")
EVERY = 3
HEADER = "trial,t_s,pressure_0_kPa,pressure_1_kPa,pressure_2_kPa,pressure_3_kPa,bend_deg,bend_direction_deg,valid"
COMMENTS = (
    "Four-chamber soft pneumatic arm, link rb1-rb2: 20 s holds of one chamber and the releases after them, at 20 Hz.",
    "Source: ASU-RISE-Lab/4-chamber-softarm-control (MIT, see LICENSE), trials apr4_1 ... apr4_4.",
    "Made by: python -m calib.reduce_asu_series SOURCE_DIR OUT.csv. Rest length of the link: 134 mm.",
)


def reduced(folder: Path) -> str:
    """The shipped recording. Raises InputError when the folder is not the measured arm's."""
    lines = [*(f"# {line}" for line in COMMENTS), HEADER]
    for trial in TRIALS:
        for sample in read_rows_of(folder / f"{trial}.csv")[::EVERY]:
            pressures = (PSI_KPA * float(sample[f"pm_{channel}_psi"]) for channel in CHANNEL_OF_CHAMBER)
            cells = [trial, f"{float(sample['t_s']):.3f}", *(f"{value:.2f}" for value in pressures)]
            if sample["flag_rb1_rb2_ok"] == "1":
                along_x, along_y = _rotation_vector_deg(sample)
                bend_deg, direction_deg = math.hypot(along_x, along_y), math.degrees(math.atan2(along_x, along_y))
                cells += [f"{bend_deg:.2f}", f"{direction_deg:.1f}", "1"]
            else:
                cells += ["", "", "0"]
            lines.append(",".join(cells))
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """The command: 0 when the recording was written, 2 with a message on standard error for bad input."""
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        if len(arguments) != 2:
            raise InputError("usage: python -m calib.reduce_asu_series SOURCE_DIR OUT.csv")
        Path(arguments[1]).write_text(reduced(Path(arguments[0])), encoding="utf-8")
    except SoftbotError as error:
        print(error, file=sys.stderr)
        return error.exit_status
    return 0


def _rotation_vector_deg(sample: dict[str, str]) -> tuple[float, float]:
    """Components along x and y of the rotation vector of rb2 against rb1 [deg]; its twist about z is below 1°."""
    quaternion = relative_rotation(sample)
    quaternion = quaternion * (1.0 if quaternion[3] >= 0.0 else -1.0)
    sine = float(np.linalg.norm(quaternion[:3]))
    turn = math.degrees(2.0 * math.atan2(sine, quaternion[3])) / max(sine, 1e-12)
    return turn * float(quaternion[0]), turn * float(quaternion[1])


if __name__ == "__main__":
    raise SystemExit(main())
