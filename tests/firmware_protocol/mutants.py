"""Mutation testing of the safety and end-to-end modules: `make mutants`.

Each mutant is one of the modules with one small change; the tests have to notice it. Every part of the source is
changed, constants, properties and defaults of classes among it (which mutmut 3 leaves alone, and which hold the limits
here):

- comparisons moved to their neighbour and turned round; `and` and `or` exchanged, and each operand left out;
- arithmetic and bit operations exchanged; `not` and minus left out; conditions turned round;
- numbers one up and one down, booleans turned round, texts that are not messages changed;
- members of enumerations replaced by the next one;
- statements left out; returned values replaced by None.

A mutant runs in a process forked off one that has loaded everything else. It is killed by a failing test or by taking
more than a minute of processor time. A survivor has to be explained in mutants.toml; an explanation of a mutant that
does not survive fails too. What is run, and against which tests, stands in pyproject.toml under [tool.mutants].

    python tests/firmware_protocol/mutants.py [--module NAME]… [--list]
"""

from __future__ import annotations

import argparse
import ast
import copy
import io
import os
import resource
import sys
import time
import tomllib
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_loader
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).parents[2]
EXPLAINED = Path(__file__).with_name("mutants.toml")
PACKAGE = "firmware_protocol"
KEPT_MODULES = ("spec", "errors", "frame", "enumerations")
"""Modules of the package that import none of those that are mutated: loaded once for all mutants."""
TIME_LIMIT_S = 60

COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
OPERATIONS: dict[type[ast.operator], tuple[type[ast.operator], ...]] = {
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.FloorDiv,),
    ast.Div: (ast.Mult,),
    ast.FloorDiv: (ast.Mult,),
    ast.Mod: (ast.FloorDiv,),
    ast.LShift: (ast.RShift,),
    ast.RShift: (ast.LShift,),
    ast.BitAnd: (ast.BitOr,),
    ast.BitOr: (ast.BitAnd, ast.BitXor),
    ast.BitXor: (ast.BitOr, ast.BitAnd),
}
REMOVABLE = (ast.Expr, ast.Assign, ast.AugAssign, ast.AnnAssign, ast.Raise, ast.Return, ast.If, ast.For)


@dataclass(frozen=True)
class Mutant:
    """One changed module. `place`: the source line as it stands; `change`: what became of it."""

    module: str
    line: int
    place: str
    change: str
    source: str

    @property
    def key(self) -> tuple[str, str, str]:
        return self.module, self.place, self.change


def mutants_of(module: str) -> list[Mutant]:
    """All mutants of a module, in the order of its lines."""
    source = (ROOT / PACKAGE / f"{module}.py").read_text(encoding="utf-8")
    tree = ast.parse(source)
    lines = source.splitlines()
    members = enumeration_members()
    found = []
    for number, node in enumerate(nodes_of(tree)):
        for variant in range(len(list(changes(node, members)))):
            changed = ast.parse(source)
            target = list(nodes_of(changed))[number]
            replacement = list(changes(target, members))[variant]
            new = ast.fix_missing_locations(Replace(target, replacement).visit(changed))
            found.append(
                Mutant(
                    module,
                    node.lineno,
                    lines[node.lineno - 1].strip(),
                    f"{shown(node)} -> {shown(replacement)}",
                    ast.unparse(new),
                )
            )
    return sorted(found, key=lambda each: each.line)


def nodes_of(tree: ast.Module) -> Iterator[ast.AST]:
    """The nodes that may be changed: no docstrings, annotations, imports, nor what errors and exceptions say."""
    stack: list[tuple[ast.AST, str]] = [(tree, "")]
    while stack:
        node, _ = stack.pop()
        if hasattr(node, "lineno"):
            yield node
        if isinstance(node, ast.Import | ast.ImportFrom | ast.JoinedStr | ast.Raise | ast.Dict):
            if not isinstance(node, ast.Dict):
                continue
            stack += [(value, "value") for value in reversed(node.values)]
            continue
        for name, value in reversed(list(ast.iter_fields(node))):
            if name in ("annotation", "returns", "decorator_list", "bases"):
                continue
            for child in reversed(value) if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST) and not is_text(child):
                    stack.append((child, name))


def is_text(node: ast.AST) -> bool:
    """A docstring, or the text below a constant that says what it is."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def changes(node: ast.AST, members: dict[str, list[str]]) -> Iterator[ast.AST]:
    """What the node may become."""
    if isinstance(node, ast.Compare):
        for place, operator in enumerate(node.ops):
            for other in COMPARISONS[type(operator)]:
                new = copy.deepcopy(node)
                new.ops[place] = other()
                yield new
    elif isinstance(node, ast.BoolOp):
        new_bool = copy.deepcopy(node)
        new_bool.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        yield new_bool
        yield from (copy.deepcopy(each) for each in without_each(node.values, node.op))
    elif isinstance(node, ast.BinOp | ast.AugAssign):
        for other_operation in OPERATIONS.get(type(node.op), ()):
            new_operation = copy.deepcopy(node)
            new_operation.op = other_operation()
            yield new_operation
    elif isinstance(node, ast.UnaryOp):
        yield copy.deepcopy(node.operand)
    elif isinstance(node, ast.Constant):
        yield from (ast.Constant(value) for value in other_constants(node.value))
    elif isinstance(node, ast.IfExp):
        new_choice = copy.deepcopy(node)
        new_choice.test = ast.UnaryOp(ast.Not(), new_choice.test)
        yield new_choice
    elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in members:
        names = members[node.value.id]
        if node.attr in names:
            new_member = copy.deepcopy(node)
            new_member.attr = names[(names.index(node.attr) + 1) % len(names)]
            yield new_member
    if isinstance(node, ast.If):
        turned = copy.deepcopy(node)
        turned.test = ast.UnaryOp(ast.Not(), turned.test)
        yield turned
    if isinstance(node, ast.Return) and not (node.value is None or is_none(node.value)):
        yield ast.Return(ast.Constant(None))
    if isinstance(node, REMOVABLE) and not isinstance(node, ast.Return):
        yield ast.Pass()


def without_each(values: list[ast.expr], operator: ast.boolop) -> Iterator[ast.expr]:
    for place in range(len(values)):
        rest = [value for other, value in enumerate(values) if other != place]
        yield rest[0] if len(rest) == 1 else ast.BoolOp(operator, rest)


def other_constants(value: object) -> Iterator[object]:
    if isinstance(value, bool):
        yield not value
    elif isinstance(value, int | float):
        yield value + 1
        yield value - 1
    elif isinstance(value, str):
        yield value + "X"


def is_none(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and node.value is None


def shown(node: ast.AST) -> str:
    text = ast.unparse(node).splitlines()[0]
    return text if len(text) <= 90 else text[:87] + "..."


def enumeration_members() -> dict[str, list[str]]:
    from enum import Enum

    from firmware_protocol import enumerations

    enums = {name: each for name, each in vars(enumerations).items() if isinstance(each, type)}
    found = {
        name: [member.name for member in each]
        for name, each in enums.items()
        if issubclass(each, Enum) and each.__members__
    }
    tree = ast.parse((ROOT / PACKAGE / "e2e.py").read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef) and node.name == "FrameStatus":
            found[node.name] = [
                each.targets[0].id
                for each in node.body
                if isinstance(each, ast.Assign) and isinstance(each.targets[0], ast.Name)
            ]
    return found


class Replace(ast.NodeTransformer):
    def __init__(self, target: ast.AST, replacement: ast.AST) -> None:
        self.target, self.replacement = target, replacement

    def visit(self, node: ast.AST) -> ast.AST:
        if node is self.target:
            return self.replacement
        self.generic_visit(node)
        return node


# ---------------------------------------------------------------------- running them


class MutatedModule(MetaPathFinder, Loader):
    """Loads one module of the package from a source of our own."""

    def __init__(self, mutant: Mutant) -> None:
        self.name, self.source = f"{PACKAGE}.{mutant.module}", mutant.source

    def find_spec(self, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        return spec_from_loader(name, self) if name == self.name else None

    def create_module(self, spec: ModuleSpec) -> None:
        return None

    def exec_module(self, module: ModuleType) -> None:
        exec(compile(self.source, f"<mutant of {self.name}>", "exec"), module.__dict__)


def survives(mutant: Mutant, stages: list[list[str]]) -> bool:
    """Whether every stage of tests passes on a mutant."""
    return all(passes(mutant, tests) for tests in stages)


def passes(mutant: Mutant, tests: list[str]) -> bool:
    """Runs tests on a mutant in a forked process."""
    child = os.fork()
    if child == 0:
        status = 99
        try:
            resource.setrlimit(resource.RLIMIT_CPU, (TIME_LIMIT_S, TIME_LIMIT_S))
            status = run_tests(mutant, tests)
        finally:
            os._exit(status)
    _, ended = os.waitpid(child, 0)
    return os.WIFEXITED(ended) and os.WEXITSTATUS(ended) == 0


def run_tests(mutant: Mutant, tests: list[str]) -> int:
    """0 if all tests pass. Only for the forked process: its modules are thrown away."""
    import pytest

    for name in [name for name in sys.modules if name.startswith(f"{PACKAGE}.") and name not in KEPT]:
        del sys.modules[name]
        delattr(sys.modules[PACKAGE], name.split(".")[1])
    sys.meta_path.insert(0, MutatedModule(mutant))
    own_first = sorted(tests, key=lambda each: f"/test_{mutant.module}." not in each and not each.startswith("-m"))
    with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere), redirect_stderr(io.StringIO()):
        return int(pytest.main([*PYTEST_OPTIONS, *own_first]))


# Not the board in C: compiling it for each mutant of the board in Python would only take time.
PYTEST_OPTIONS = ["-x", "-q", "--assert=plain", "-k", "not compiled"]
PYTEST_OPTIONS += [f"-pno:{name}" for name in ("cacheprovider", "xdist", "cov")]
KEPT = tuple(f"{PACKAGE}.{name}" for name in KEPT_MODULES)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--module", action="append", help="only this module (may be given more than once)")
    parser.add_argument("--list", action="store_true", help="show the mutants and run none")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    asked = parser.parse_args()
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    config = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["mutants"]
    modules = asked.module or config["modules"]
    mutants = [mutant for module in modules for mutant in mutants_of(module)]
    if asked.list:
        for mutant in mutants:
            print(f"{mutant.module}:{mutant.line}: {mutant.change}")
        print(f"{len(mutants)} mutants")
        return 0
    load_what_stays()
    unchanged = Mutant(modules[0], 0, "", "", (ROOT / PACKAGE / f"{modules[0]}.py").read_text(encoding="utf-8"))
    default = "not slow and not stress"
    stages = [
        [f"-m{default} and not hypothesis", *config["quick_tests"]],
        [f"-m{default} and hypothesis", *config["quick_tests"]],
        [f"-m{default}", *config["more_tests"]],
    ]
    if not survives(unchanged, stages):
        print("the tests fail without any mutant: python -m pytest", *config["quick_tests"], *config["more_tests"])
        return 1
    started = time.monotonic()
    survivors: list[Mutant] = []
    with ThreadPoolExecutor(asked.workers) as pool:
        for done, (mutant, alive) in enumerate(
            zip(mutants, pool.map(lambda each: survives(each, stages), mutants), strict=True), start=1
        ):
            if alive:
                survivors.append(mutant)
                print(f"survived: {mutant.module}.py:{mutant.line}: {mutant.place!r}: {mutant.change}", flush=True)
            if done % 100 == 0:
                print(
                    f"{done} of {len(mutants)} mutants, {len(survivors)} survivors, {time.monotonic() - started:.0f} s"
                )
    return report(modules, mutants, survivors)


def load_what_stays() -> None:
    import hypothesis
    import numba
    import numpy
    import pytest

    from firmware_protocol import enumerations, errors, frame, spec

    spec.spec()
    assert all((hypothesis, numba, numpy, pytest, enumerations, errors, frame))


def report(modules: list[str], mutants: list[Mutant], survivors: list[Mutant]) -> int:
    """Prints the counts and what is not as it should be; the exit status."""
    known = tomllib.loads(EXPLAINED.read_text(encoding="utf-8")).get("survivor", [])
    explained = Counter((each["module"], each["place"], each["change"]) for each in known if each["module"] in modules)
    alive = Counter(mutant.key for mutant in survivors)
    for module in modules:
        total = sum(mutant.module == module for mutant in mutants)
        left = [mutant for mutant in survivors if mutant.module == module]
        print(f"{module}: {total} mutants, {total - len(left)} killed, {len(left)} survived")
    unexplained = alive - explained
    stale = explained - alive
    for mutant in survivors:
        if unexplained[mutant.key] > 0:
            print(f"UNEXPLAINED {mutant.module}.py:{mutant.line}: {mutant.place!r}: {mutant.change}")
    for module, place, change in stale:
        print(f"EXPLAINED BUT NOT ALIVE {module}: {place!r}: {change}")
    print(
        f"{len(mutants)} mutants, {len(mutants) - len(survivors)} killed, {len(survivors)} survived, "
        f"{sum(unexplained.values())} of them unexplained"
    )
    return 1 if unexplained or stale else 0


if __name__ == "__main__":
    sys.exit(main())
