"""Lines and branches of the C reference that its tests run: a table, and exit 1 unless all of them are.

python .ci/c_coverage.py FOLDER        FOLDER holds what tests compiled with --coverage left there (make c-coverage)
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path


def counts_by_line(folder: Path) -> dict[str, dict[int, tuple[int, list[int]]]]:
    """By file and line of the reference: how often it ran, and how often each of its branches was taken."""
    found: dict[str, dict[int, tuple[int, list[int]]]] = {}
    for data in sorted(folder.glob("*.gcda")):
        done = subprocess.run(
            ["gcov", "--json-format", "--stdout", "--branch-probabilities", data.name],
            cwd=folder,
            capture_output=True,
            text=True,
            check=True,
        )
        for file in json.loads(done.stdout)["files"]:
            name = Path(file["file"]).name
            if not name.startswith("softbot_") or name == "softbot_host.c":
                continue
            lines = found.setdefault(name, {})
            for line in file["lines"]:
                ran, branches = lines.get(line["line_number"], (0, []))
                taken = [branch["count"] for branch in line["branches"] if not branch["throw"]]
                merged = [max(pair) for pair in zip(branches, taken, strict=True)] if branches else taken
                lines[line["line_number"]] = (max(ran, line["count"]), merged)
    return found


def main(folder: Path) -> int:
    if shutil.which("gcov") is None:
        print("softbot: gcov is not here: apt install gcc", file=sys.stderr)
        return 2
    files = counts_by_line(folder)
    if not files:
        print(f"softbot: {folder} holds no coverage data: make c-coverage", file=sys.stderr)
        return 2
    print(f"{'file':<28}{'lines':>12}{'branches':>12}  missed")
    whole = True
    for name, lines in sorted(files.items()):
        ran = sum(count > 0 for count, _ in lines.values())
        branches = [count for _, taken in lines.values() for count in taken]
        taken = sum(count > 0 for count in branches)
        missed = [str(number) for number, (count, each) in sorted(lines.items()) if count == 0 or 0 in each]
        print(f"{name:<28}{f'{ran}/{len(lines)}':>12}{f'{taken}/{len(branches)}':>12}  {', '.join(missed)}")
        whole &= not missed
    return 0 if whole else 1


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
