"""Converged values, for the cases that no formula covers: the rod at a setting finer than any that is measured.

Each is computed anew when it is asked for, with a coarser one beside it whose distance is stated: a ruler whose own
error is not known is none.
"""

from __future__ import annotations

from typing import Any

from sim.benchmark.case import Case, Ruler, RunScene
from sim.benchmark.summary_value import quantity_of

FINE_ROLL = {"twin": "rod", "modes": 9, "contact_points": 48, "step_s": 0.0005}
COARSER_ROLL = {"twin": "rod", "modes": 7, "contact_points": 36, "step_s": 0.001}
FINE_EXPERIMENT = {"twin": "rod", "modes": 7, "contact_points": 32, "step_s": 0.0005}
COARSER_EXPERIMENT = {"twin": "rod", "modes": 5, "contact_points": 24, "step_s": 0.001}


def converged_advance(case: Case, run: RunScene) -> Ruler:
    """The advance ratio of the refined rod."""
    return _converged(case, run, FINE_ROLL, COARSER_ROLL)


def converged_experiment(case: Case, run: RunScene) -> Ruler:
    """The revolutions of the refined rod under its sequencer."""
    return _converged(case, run, FINE_EXPERIMENT, COARSER_EXPERIMENT)


def _converged(case: Case, run: RunScene, fine: dict[str, Any], coarser: dict[str, Any]) -> Ruler:
    value, beside = (quantity_of(case, run(case.scene(solver))) for solver in (fine, coarser))
    apart_percent = 100.0 * abs(beside / value - 1.0)
    return Ruler((value,), f"converged: {_words(fine)} ({_words(coarser)} differs by {apart_percent:.2g} %)")


def _words(solver: dict[str, Any]) -> str:
    return f"rod, {solver['modes']} modes, {solver['contact_points']} points, {solver['step_s'] * 1e3:g} ms"
