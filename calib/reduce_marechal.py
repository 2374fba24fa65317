"""Reduce the tensile tests of castable silicones to the shipped tables: `python -m calib.reduce_marechal SOURCE_DIR`.

Source: LucMarechal/Soft-Robotics-Materials-Database (ODbL 1.0): one pull of each silicone to failure at 450 mm/min,
strain from the crosshead (ASTM D412). SOURCE_DIR holds its CSV files. What is kept: engineering strain and stress up to
LARGEST_STRAIN, which is more than the wall of a bending robot sees; every row, rounded as far as the source's own
digits carry.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from softbot.errors import InputError, SoftbotError

LARGEST_STRAIN = 1.5
NAMES = {
    "Ecoflex_00-30": "Ecoflex 00-30",
    "Ecoflex_00-50": "Ecoflex 00-50",
    "Dragon_Skin_10_MEDIUM": "Dragon Skin 10",
    "Dragon_Skin_20": "Dragon Skin 20",
    "Dragon_Skin_30": "Dragon Skin 30",
}
"""The source's file names → the names of the silicones here."""
_STRAIN, _STRESS = "Engineering Strain", "Engineering Stress (MPa)"


def reduced(source: Path) -> str:
    """The shipped table made of one file of the source. Raises InputError where the columns are not found."""
    lines = source.read_text(encoding="utf-8-sig").splitlines()
    start = next((n for n, line in enumerate(lines) if _STRAIN in line), None)
    if start is None:
        raise InputError(f"{source}: no column {_STRAIN!r}; is it a file of the Soft-Robotics-Materials-Database?")
    facts = dict(line.split(";")[:2] for line in lines[:start] if line.count(";") >= 1)
    header = lines[start].split(";")
    strain, stress = header.index(_STRAIN), header.index(_STRESS)
    rows = [line.split(";") for line in lines[start + 1 :] if line.replace(";", "").strip()]
    pulled = [(float(row[strain]), float(row[stress])) for row in rows]
    kept = [f"{e:.6g},{s:.6g}" for e, s in pulled if e <= LARGEST_STRAIN]
    comments = (
        f"{NAMES[source.stem]}: tensile test, {facts['Standard']}, {facts['Speed (mm/min)']} mm/min, single pull.",
        f"Specimen {facts['Specimen Length (mm)']} x {facts['Specimen Width (mm)']} x "
        f"{facts['Specimen Thickness (mm)']} mm; strain from the crosshead.",
        f"Source: LucMarechal/Soft-Robotics-Materials-Database, {source.name} (ODbL 1.0, see LICENSE).",
        "Made by: python -m calib.reduce_marechal SOURCE_DIR",
    )
    return "\n".join([*(f"# {one}" for one in comments), "engineering_strain,engineering_stress_MPa", *kept]) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the five tables into `calib/data/marechal_tensile`, or into a second folder if one is named."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if len(given) not in (1, 2):
        print("usage: python -m calib.reduce_marechal SOURCE_DIR [OUT_DIR]", file=sys.stderr)
        return 2
    out = Path(given[1]) if len(given) == 2 else Path(__file__).parent / "data" / "marechal_tensile"
    try:
        for stem in NAMES:
            source = Path(given[0]) / f"{stem}.csv"
            if not source.is_file():
                raise InputError(f"{source}: no such file; SOURCE_DIR holds the source's CSV files")
            (out / source.name).write_text(reduced(source), encoding="utf-8")
    except (SoftbotError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
