"""Work against precision: run time per simulated second against error, for the twins and for engines of others.

A case (`case`) is physics and a ruler; an engine (`engine`) turns it into a motion at several settings; what is read
off the motion (`play`, `summary_value`) is the same for all. `measurement` makes the rows, `scaling` how the cost
grows, `table` and `figure` show them, `stamp` says what they were measured with.
"""

from sim.benchmark.case import Case, RunScene, cases
from sim.benchmark.engine import Engine, engines
from sim.benchmark.measurement import measure, simulate_summary
from sim.benchmark.result import Growth, Result

__all__ = ["Case", "Engine", "Growth", "Result", "RunScene", "cases", "engines", "measure", "simulate_summary"]
