"""Reduce the four-chamber arm's trials to the shipped table: `python -m calib.reduce_asu SOURCE_DIR OUT.csv`.

Source: ASU-RISE-Lab/4-chamber-softarm-control (MIT), trials `apr4_1 … 7`: 20 s holds, then release, of an arm of two
segments. SOURCE_DIR holds `steady_holds.csv` (means over each hold) and the trials themselves. The link between the
rigid bodies rb1 (fixed) and rb2 is driven by the three channels `b_r`, `b_l`, `b_m`. What is concluded here:

**Chambers.** `b_r` and `b_l` alone displace rb2 to +x and −x: opposite chambers, 0 and 2. `b_m` feeds the two
between them, 1 and 3, together: all three channels at 103 kPa lengthen the link from 134 mm to 193 mm (stretch 1.44)
and bend it by 8° at most, in the plane of 0 and 2. That is 3.7 times the mean strain of one chamber alone
(0.119), so four chambers were filled, not three; and a single chamber at right angles to 0 and 2 would have bent it
out of that plane by about 40°.

**Rows.** The loading holds in which a b channel is driven, and the releases after them. Left out: the hold of
`apr4_5` (only the other segment is driven) with its release, and holds without a valid angle.

**Bend.** `angle_rb1_rb2_deg` of the hold: the total rotation of rb2 against rb1 since the start of the trial. Its
twist about the link's axis is below 1°, so all of it is bend. The start of a trial is not quite straight: the link
keeps some degrees of its previous bend, which is part of the spread of the repeats.

**Direction.** From the rotation vector of the trial's last two fifths of the hold. With e1 from the axis to chamber 0
(−x), e2 to chamber 1 (+y) and the tangent t = −z from rb1 to rb2, a rotation vector (a_x, a_y, 0) bends towards
(k1, k2) = (a_y, a_x).

**Length.** The source has the chord between the bodies; constant curvature makes it an arc of
chord · (b/2)/sin(b/2), b the bend.
"""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softbot.errors import InputError, SoftbotError

PSI_KPA = 6.894757293168
CHANNEL_OF_CHAMBER = ("b_r", "b_m", "b_l", "b_m")
DRIVEN_PSI = 5.0  # commanded: a released channel stands at 1 psi, a driven one at 15 psi
HEADER = (
    *(f"pressure_{i}_kPa" for i in range(4)),
    "bend_deg",
    "bend_direction_deg",
    "length_mm",
    "branch",
    "trial",
    "setpoint",
)
COMMENTS = (
    "Four-chamber soft pneumatic arm, link rb1-rb2: means over 20 s holds and over the releases after them.",
    "Source: ASU-RISE-Lab/4-chamber-softarm-control (MIT, see LICENSE), trials apr4_1 ... apr4_7.",
    "Made by: python -m calib.reduce_asu SOURCE_DIR OUT.csv (its docstring says what was concluded).",
    "length: arc of the measured chord under constant curvature. setpoint: commanded psi of chambers 0-1-2-3.",
)


def arc_length(chord: float, bend_rad: float) -> float:
    """Length of the circular arc over a chord that turns by `bend_rad` (unit of the chord)."""
    half = 0.5 * bend_rad
    return chord * (half / math.sin(half) if half > 1e-9 else 1.0)


def reduce_holds(folder: Path) -> list[dict[str, str]]:
    """The rows of the reduced table. Raises InputError when the folder is not the measured arm's."""
    rows = []
    driven_before: dict[str, str] = {}
    for hold in read_rows_of(folder / "steady_holds.csv"):
        commanded = [float(hold[f"pd_{channel}"]) for channel in CHANNEL_OF_CHAMBER]
        loading = max(commanded) > DRIVEN_PSI
        setpoint = "-".join(f"{value:g}" for value in commanded)
        trial = hold["file"].removesuffix(".csv")
        if loading:
            driven_before[trial] = setpoint
        elif trial not in driven_before:
            continue  # only the other segment was driven
        bend_deg, chord_mm = float(hold["angle_rb1_rb2_deg"]), float(hold["dist_rb1_rb2_mm"])
        if not math.isfinite(bend_deg):
            continue
        start_s, hold_s = float(hold["t_start_s"]), float(hold["hold_s"])
        turn = _rotation_vector_deg(folder / hold["file"], start_s + 0.6 * hold_s, start_s + hold_s)
        pressure_kPa = [PSI_KPA * float(hold[f"pm_{channel}"]) for channel in CHANNEL_OF_CHAMBER]
        direction_deg = math.degrees(math.atan2(turn[0], turn[1])) % 360.0
        cells = (
            *(f"{value:.2f}" for value in pressure_kPa),
            f"{bend_deg:.2f}",
            f"{direction_deg:.1f}",
            f"{arc_length(chord_mm, math.radians(bend_deg)):.2f}",
            "loading" if loading else "unloading",
            trial,
            setpoint if loading else f"{setpoint} after {driven_before[trial]}",
        )
        rows.append(dict(zip(HEADER, cells, strict=True)))
    return rows


def write_table(rows: list[dict[str, str]], out: Path) -> None:
    """Write the reduced table with its source in comment lines."""
    with out.open("w", newline="", encoding="utf-8") as stream:
        stream.writelines(f"# {line}\n" for line in COMMENTS)
        writer = csv.DictWriter(stream, HEADER, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command: 0 when the table was written, 2 with a message on standard error for bad input."""
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        if len(arguments) != 2:
            raise InputError("usage: python -m calib.reduce_asu SOURCE_DIR OUT.csv")
        write_table(reduce_holds(Path(arguments[0])), Path(arguments[1]))
    except SoftbotError as error:
        print(error, file=sys.stderr)
        return error.exit_status
    return 0


def read_rows_of(path: Path) -> list[dict[str, str]]:
    """Rows of one of the source's CSV files. Raises InputError where it cannot be read."""
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            return list(csv.DictReader(stream))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; name the folder of the measured arm") from None


def _rotation_vector_deg(trial: Path, from_s: float, to_s: float) -> NDArray[np.float64]:
    """Median rotation vector of rb2 against rb1 over a span, in rb1's axes, shape (3,) [deg].

    Against the first 20 samples of the trial, as the source's angle; only samples whose quaternions are flagged good.
    """
    samples = read_rows_of(trial)
    relative = np.array([relative_rotation(sample) for sample in samples])
    relative *= np.where(relative @ relative[0] < 0.0, -1.0, 1.0)[:, None]
    start = relative[:20].mean(axis=0)
    start /= np.linalg.norm(start)
    time_s = np.array([float(sample["t_s"]) for sample in samples])
    good = np.array([sample["flag_rb1_rb2_ok"] == "1" for sample in samples])
    chosen = relative[good & (time_s >= from_s) & (time_s <= to_s)]
    turns = np.array([_multiply(quaternion, _conjugate(start)) for quaternion in chosen])
    turns *= np.sign(turns[:, 3:])
    sine = np.linalg.norm(turns[:, :3], axis=1, keepdims=True)
    return np.degrees(np.median(turns[:, :3] / sine * 2.0 * np.arctan2(sine, turns[:, 3:]), axis=0))


def relative_rotation(sample: dict[str, str]) -> NDArray[np.float64]:
    """Quaternion (x, y, z, w) of rb2 against rb1."""
    first, second = (np.array([float(sample[f"{body}_q{axis}"]) for axis in "xyzw"]) for body in ("rb1", "rb2"))
    return _multiply(_conjugate(first), second)


def _conjugate(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    return quaternion * np.array([-1.0, -1.0, -1.0, 1.0])


def _multiply(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Hamilton product of quaternions (x, y, z, w)."""
    vector = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    return np.array([*vector, a[3] * b[3] - a[:3] @ b[:3]])


if __name__ == "__main__":
    raise SystemExit(main())
