"""Compilation of kernels before their first use, by running the smallest experiments in separate processes."""

from collections.abc import Callable, Iterable

from ..core.laws.builtin import hertz_mindlin
from ..ensemble import run_members
from ..experiments.registry import EXPERIMENTS, scenario, simulate
from ..loading.packing import jammed
from ..solve.equilibrate import equilibrate
from ..solve.stability import stability

STABILITY = "stability"
FIRST = STABILITY, "disk-array"  # what most users try first
_FRACTION = {2: 0.9, 3: 0.68}  # packing fractions that jam


def kinds() -> tuple[str, ...]:
    """Names of what can be compiled: stability analyses, and every experiment that defines a smallest run."""
    return STABILITY, *(name for name, one in EXPERIMENTS.items() if one.smallest)


def compile_kernels(names: Iterable[str], *, workers: int | None = None, report: Callable) -> list[str]:
    """Compile kernels of stability analyses and experiments, and return one sentence for each run that failed.

    Parameters
    ----------
    names : some of `kinds()`
    workers : number of processes; default: one per core
    report : called as report(stage, fraction done, kernel being compiled)
    """
    tasks = [(name, k) for name in names for k in range(_count(name))]
    found = run_members(_run, tasks, workers=workers, live=lambda share, words: report("kernels", share, words))
    return [f"{name}: {one.failure}" for (name, _), one in zip(tasks, found, strict=True) if one.failure]


def _count(name: str) -> int:
    return len(_FRACTION) if name == STABILITY else len(EXPERIMENTS[name].smallest)


def _run(name: str, k: int, tell: Callable) -> None:
    """Run something small that needs the kernels."""
    tell(0.0, name)
    if name == STABILITY:
        dim = 2 + k
        law = hertz_mindlin(mu=0.5)
        state, _ = jammed(20, packing_fraction=_FRACTION[dim], dim=dim, seed=1)
        stability(equilibrate(state, law)[0], law)
    else:
        simulate(scenario(experiment=name, **EXPERIMENTS[name].smallest[k]), workers=1)
