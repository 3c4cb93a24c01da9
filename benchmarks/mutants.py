"""Do the tests notice? Random small changes to the source, and which of them make a test fail.

    nice -n 19 python -m benchmarks.mutants [--mutants 150] [--seed 0] [--minutes 50]
        [--of runtime/compensation models] [--out bench/mutants.jsonl]

Each mutant changes one operator, number, condition or statement of what filters, runs, watches,
calibrates or reads bags, in a copy of the sources; then the tests of that package run until one
fails. Text,
types and messages are left alone. What is in the file is not run again, so that a long run can be
made in pieces. A mutant on which the tests hang counts as killed.
"""

import ast
import copy
import importlib
import json
import os
import resource
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import parsed

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "src" / "truejoint"
TESTS = {
    "filters": ("tests/filters",),  # its modules are one filter
    "runtime": ("tests/runtime/test_status.py", "tests/runtime/test_corrector.py"),
    "calibration": ("tests/calibration/test_calibration.py", "tests/calibration/test_fit.py"),
    "recordings/read/bags": ("tests/recordings/read/bags",),
}
"""What runs on a mutant of a module that has no tests of its own."""
MIRRORS = {
    "filters/filter": ("tests/filters",),
    "runtime/compensation": ("tests/runtime/test_compensator.py",),
    "runtime/limits": ("tests/runtime/test_status.py", "tests/runtime/test_parity.py"),
    "runtime/correction": ("tests/runtime/test_status.py", "tests/runtime/test_parity.py"),
    "calibration/calibration": ("tests/calibration/test_conformal.py",),
    "calibration/interval": ("tests/calibration/test_conformal.py",),
    "calibration/redundancy": ("tests/runtime/test_parity.py",),
    "calibration/compatibility": ("tests/calibration/test_truth_zero.py",),
    "calibration/efforts": ("tests/calibration/test_truth_zero.py",),
    "calibration/potentiometers": ("tests/calibration/test_potentiometer_zero.py",),
    "calibration/zero": ("tests/calibration/test_truth_zero.py",),
    "calibration/fit_task": ("tests/calibration/test_truth_zero.py",),
}
"""Tests of a module beside those of its own name."""
LONGEST = 120  # s of processor time
PRELOADED = ("hypothesis", "numba", "pandas", "pyarrow.parquet", "pytest", "safetensors.numpy",
             "scipy.optimize", "scipy.stats", "sklearn.ensemble")  # fmt: skip

SWAPS: dict[type[ast.AST], tuple[type[ast.AST], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt), ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,), ast.In: (ast.NotIn,), ast.NotIn: (ast.In,), ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,), ast.Mult: (ast.Div,), ast.Div: (ast.Mult,), ast.FloorDiv: (ast.Mult,),
    ast.Mod: (ast.FloorDiv,), ast.Pow: (ast.Mult,), ast.And: (ast.Or,), ast.Or: (ast.And,),
    ast.BitOr: (ast.BitAnd,), ast.BitAnd: (ast.BitOr,), ast.USub: (ast.UAdd,),
}  # fmt: skip
"""What an operator is changed to."""


@dataclass(frozen=True)
class Mutant:
    """One change, and what came of it."""

    file: str  # below src/truejoint
    line: int
    before: str
    after: str
    outcome: str = field(default="", compare=False)  # "killed", "survived" or "hung"
    by: str = field(default="", compare=False)  # the test that failed
    seconds: float = field(default=0.0, compare=False)


def changes(tree: ast.AST) -> Iterator[tuple[Any, ast.AST]]:
    """Every node that can be changed, with what it is changed to."""
    if isinstance(tree, ast.Raise | ast.Import | ast.ImportFrom | ast.JoinedStr):
        return
    if isinstance(tree, ast.If) and "TYPE_CHECKING" in ast.dump(tree.test):
        return
    yield from _own_changes(tree)
    for name, value in ast.iter_fields(tree):
        if name in {"annotation", "returns", "decorator_list", "keywords"} and not (
            name == "keywords" and isinstance(tree, ast.Call)
        ):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield from changes(child)


def _own_changes(node: ast.AST) -> Iterator[tuple[ast.AST, ast.AST]]:
    """Change a node itself, not those below it."""
    match node:
        case ast.UnaryOp(op=ast.Not()):
            yield node, node.operand
        case ast.BinOp() | ast.BoolOp() | ast.UnaryOp() | ast.AugAssign():
            for other in SWAPS.get(type(node.op), ()):
                yield node, _with(node, op=other())
        case ast.Compare():
            for other in SWAPS[type(node.ops[0])]:
                yield node, _with(node, ops=[other(), *node.ops[1:]])
        case ast.Constant(value=bool(value)):
            yield node, ast.Constant(not value)
        case ast.Constant(value=int(value) | float(value)):
            yield node, ast.Constant(value + 1 if isinstance(value, int) else 2.0 * value or 1.0)
        case ast.If() | ast.IfExp() | ast.While():
            yield node.test, ast.UnaryOp(ast.Not(), node.test)
        case ast.Break() | ast.Continue() | ast.Expr(value=ast.Call()):
            yield node, ast.Pass()


def _with(node: ast.AST, **fields: object) -> ast.AST:
    changed = copy.copy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed


def all_mutants(wanted: Sequence[str]) -> list[tuple[Mutant, str]]:
    """Every mutant of these packages and modules, with the text of its file."""
    found = []
    for package in TESTS:
        for path in sorted((PACKAGE / package).glob("*.py")):
            if not {package, f"{package}/{path.stem}"} & set(wanted):
                continue
            text = path.read_bytes()
            starts = np.cumsum([0, *map(len, text.splitlines(keepends=True))])
            tree = ast.parse(text)
            for node, changed in changes(tree):
                begin = starts[node.lineno - 1] + node.col_offset
                end = starts[node.end_lineno - 1] + node.end_col_offset
                before, after = text[begin:end].decode(), ast.unparse(changed)
                if isinstance(node, ast.expr):
                    after = f"({after})"
                mutated = text[:begin] + after.encode() + text[end:]
                mutant = Mutant(f"{package}/{path.name}", node.lineno, before, after)
                found.append((mutant, mutated.decode()))
    return found


def judge(mutant: Mutant, text: str, folder: Path) -> Mutant:
    """Run the tests on a mutant in a copy of sources and tests, and leave the copy as it was.

    Kernels that hold what it changes are compiled anew, in place of those that were kept.
    """
    path = folder / "src" / "truejoint" / mutant.file
    kept = {cached: cached.read_bytes() for cached in folder.rglob("*.nb?")}
    original, stamps = path.read_bytes(), path.stat()
    path.write_text(text)
    package, _, module = mutant.file[:-3].rpartition("/")
    mirrors = [f"tests/{package}/test_{module}.py", *MIRRORS.get(f"{package}/{module}", ())]
    tests = [name for name in mirrors if (folder / name).exists()] or TESTS[package]
    before = os.times()
    child = os.fork()
    if child == 0:
        _run_tests(folder, tests)
    _, code = os.waitpid(child, 0)
    after = os.times()
    path.write_bytes(original)
    os.utime(path, ns=(stamps.st_atime_ns, stamps.st_mtime_ns))  # else all compiles anew
    for cached in folder.rglob("*.nb?"):
        cached.unlink()
    for cached, content in kept.items():
        cached.write_bytes(content)
    said = (folder / "said").read_text(errors="replace")
    failed = [line for line in said.splitlines() if line.startswith(("FAILED", "ERROR"))]
    outcome = "survived" if code == 0 else "hung" if os.WIFSIGNALED(code) else "killed"
    by = failed[0].split(" - ")[0] if failed else said[-200:] if code else ""
    seconds = sum(after[2:4]) - sum(before[2:4])
    return replace(mutant, outcome=outcome, by=by, seconds=seconds)


def _run_tests(folder: Path, tests: Sequence[str]) -> None:
    """Run tests until one fails, in a process that ends with it; what it says goes to a file."""
    resource.setrlimit(resource.RLIMIT_CPU, (LONGEST, LONGEST))
    out = os.open(folder / "said", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(out, 1)
    os.dup2(out, 2)
    os.chdir(folder)
    os.environ |= {"TRUEJOINT_DATA": str(folder), "OMP_NUM_THREADS": "1"}
    sys.path[:0] = [str(folder / "src"), str(folder)]
    options = ["-x", "-n", "0", "-p", "no:cacheprovider", "--hypothesis-seed=0", "--tb=no"]
    code = sys.modules["pytest"].main([*options, *tests])
    sys.stdout.flush()
    os._exit(int(code))


def main() -> None:
    """Make mutants, run the tests on each, and print what survived."""
    options = parsed(
        __doc__, mutants=150, seed=0, minutes=50.0, of=list(TESTS), out=Path("bench/mutants.jsonl")
    )
    options.out.parent.mkdir(parents=True, exist_ok=True)
    lines = options.out.read_text().splitlines() if options.out.exists() else []
    known = {mutant: mutant for mutant in (Mutant(**json.loads(line)) for line in lines)}
    every = all_mutants(options.of)
    chosen = np.random.default_rng(options.seed).permutation(len(every))[: options.mutants]
    for name in PRELOADED:  # not truejoint: each mutant imports its own
        importlib.import_module(name)
    ends = time.monotonic() + 60.0 * options.minutes
    judged = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for copied in ("src", "tests"):
            shutil.copytree(ROOT / copied, folder / copied)  # with time stamps: kernels stay
        shutil.copy(ROOT / "pyproject.toml", folder)
        for index in chosen:
            mutant, text = every[index]
            if mutant not in known and time.monotonic() < ends:
                known[mutant] = judge(mutant, text, folder)
                with options.out.open("a") as file:
                    file.write(json.dumps(asdict(known[mutant])) + "\n")
            if mutant in known:
                judged.append(known[mutant])
    outcomes = Counter(mutant.outcome for mutant in judged)
    alive = outcomes["survived"]
    print(f"{len(judged)} of {len(every)} possible mutants, seed {options.seed}: "
          f"{100 * (1 - alive / max(len(judged), 1)):.0f} % killed")  # fmt: skip
    for mutant in judged:
        if mutant.outcome == "survived":
            print(f"{mutant.file}:{mutant.line}: {mutant.before} -> {mutant.after}")


if __name__ == "__main__":
    main()
