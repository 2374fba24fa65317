"""How a scene would be solved, on the terminal: what was chosen with what error, and what is left out and why."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sim.plan import Plan
    from sim.scene import Scene


def explain_plan(scene: Scene, *, json: bool) -> None:
    """Print the plan of a scene (`json`: as one JSON object and nothing else). Raises InputError as a run would."""
    import typer

    from sim.plan import make_plan

    plan = make_plan(scene)
    if json:
        import json as json_format

        typer.echo(json_format.dumps(plan.table(), indent=2))
        return
    _show(plan)


def _show(plan: Plan) -> None:
    from rich.console import Console
    from rich.table import Table

    scene, console = plan.scene, Console()
    if plan.resolution is None:
        console.print(
            f"{scene.name}: segment twin, {plan.segments} segments, steps of {1e3 * plan.step_s:g} ms; "
            f"its accuracy is measured, not estimated (benchmarks/twins.md), and it leaves nothing out",
            highlight=False,
        )
        return
    chosen = plan.resolution
    promise = f"errors up to {percent(chosen.target)}"
    if chosen.error > chosen.target:
        given = any(choice.given for _, _, choice, _ in plan.choices())
        why = "with what the scene states" if given else "at the finest that is taken"
        promise = f"{promise} asked for, {percent(chosen.error)} estimated {why}"
    console.print(f"{scene.name}: rod twin, accuracy {scene.solver.accuracy}: {promise}", style="bold", highlight=False)
    table = Table(box=None, pad_edge=False)
    for heading in ("chosen", "value", "estimated error"):
        table.add_column(heading)
    table.add_column("why", overflow="fold")
    for name, value, choice, why in plan.choices():
        table.add_row(name, value, percent(choice.error), "given in the scene" if choice.given else why)
    table.add_row("together", "", percent(chosen.error), "")
    console.print(table, highlight=False)
    console.print()
    table = Table(box=None, pad_edge=False)
    for heading in ("rule", "left out"):
        table.add_column(heading)
    table.add_column("what that saves", overflow="fold")
    table.add_column("why", overflow="fold")
    for decision in plan.decisions:
        table.add_row(decision.name, "yes" if decision.left_out else "no", decision.saves, decision.reason)
    console.print(table, highlight=False)


def percent(share: float) -> str:
    """A share in percent, in two figures."""
    return f"{100.0 * share:.2g} %"
