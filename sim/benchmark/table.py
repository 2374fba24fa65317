"""The benchmark's answer as Markdown."""

from __future__ import annotations

from collections.abc import Sequence

from sim.benchmark.result import Growth, Result

_HEAD = "| case | engine | setting | value | ruler | error [%] | wall time per simulated s [ms] | × real time |"
_FASTEST_HEAD = "| case | rod twin | segment twin | MuJoCo | PyElastica |"
_ENGINES = ("rod", "bullet", "mujoco", "pyelastica")
_GROWTH_HEAD = "| grows | to | wall time per simulated s [ms] | × real time, all robots |"


def markdown(results: Sequence[Result]) -> str:
    """Results as a table; what an engine could not do is said in its row."""
    lines = [_HEAD, "|---|---|---|---|---|---|---|---|"]
    for r in results:
        if r.reason is not None or r.value is None:
            lines.append(f"| {r.case} | {r.engine} | {r.setting} | unable: {r.reason} | | | | |")
            continue
        lines.append(
            f"| {r.case} | {r.engine} | {r.setting} | {r.value:.5g} | {r.expected:.5g} | {r.error_percent:+.3f} "
            f"| {1e3 * (r.wall_s_per_sim_s or 0.0):.3g} | {r.real_time_factor:.3g} |"
        )
    return "\n".join(lines)


def fastest(results: Sequence[Result], within_percent: float = 1.0) -> list[Result]:
    """Of each case and engine the fastest setting whose error is within so much; where none is, the most accurate."""
    chosen = []
    for key in dict.fromkeys((r.case, r.engine) for r in results):
        rows = [r for r in results if (r.case, r.engine) == key]
        done = [r for r in rows if r.error_percent is not None and r.real_time_factor is not None]
        near = [r for r in done if abs(r.error_percent or 0.0) <= within_percent]
        if near:
            chosen.append(max(near, key=lambda r: r.real_time_factor or 0.0))
        else:
            chosen.append(min(done, key=lambda r: abs(r.error_percent or 0.0)) if done else rows[0])
    return chosen


def fastest_markdown(results: Sequence[Result], within_percent: float = 1.0) -> str:
    """`fastest` as a table, a case a line: × real time at the error."""
    chosen = {(r.case, r.engine): r for r in fastest(results, within_percent)}
    lines = [_FASTEST_HEAD, "|---|---|---|---|---|"]
    for case in dict.fromkeys(case for case, _ in chosen):
        cells = [_cell(chosen.get((case, engine))) for engine in _ENGINES]
        lines.append(f"| {case} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _cell(result: Result | None) -> str:
    if result is None:
        return ""
    if result.real_time_factor is None or result.error_percent is None:
        return "unable"
    return f"{_three_digits(result.real_time_factor)} × at {abs(result.error_percent):.2g} %"


def _three_digits(value: float) -> str:
    return f"{float(f'{value:.3g}'):,g}"


def growth_markdown(rows: Sequence[Growth]) -> str:
    """How the cost grows, as a table."""
    lines = [_GROWTH_HEAD, "|---|---|---|---|"]
    lines += [
        f"| {row.of} | {row.size:g} | {1e3 * row.wall_s_per_sim_s:.3g} | {row.real_time_factor:.3g} |" for row in rows
    ]
    return "\n".join(lines)
