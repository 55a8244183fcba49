"""Time to the first result: for the first start of each command, and for the fastest of three further starts.

The first result of a run is its first report of a physical quantity.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parent
PACKING = str(ROOT / "examples" / "sheared_spheres.npz")
FLOORS = {"column_collapse": 4, "gouge": 5, "biaxial": 5}  # limits for the first start of runs in `examples` [s]
QUANTITIES = "unbalanced", "kinetic", "stress", "friction"  # words that mark the first result of each example
EXAMPLES = "disk_array", "sphere_shear", "biaxial", "column_collapse", "plane_shear", "gouge", "rate_state"


def readme_snippet() -> str:
    """Return the first Python snippet of the README."""
    return (ROOT / "README.md").read_text(encoding="utf-8").split("```python\n")[1].split("```")[0]


def first_result(example: str) -> None:
    """Run an example until it reports a physical quantity, and end the process."""
    from stickslip.experiments.registry import read_scenario, simulate

    def report(stage: str, share: float, text: str) -> None:
        if any(quantity in text for quantity in QUANTITIES):
            os._exit(0)

    simulate(read_scenario(ROOT / "examples" / f"{example}.toml"), report=report)


def _time(words: list[str]) -> float:
    with tempfile.TemporaryDirectory() as folder:  # for files written by the command
        env = os.environ | {"PYTHONPATH": str(ROOT)}
        start = time.perf_counter()
        run = subprocess.run([sys.executable, *words], cwd=folder, env=env, capture_output=True, text=True)
        took = time.perf_counter() - start
    if run.returncode:
        raise RuntimeError(f"{' '.join(words)}: {run.stderr.strip()[-300:]}")
    return took


def rows(*, smallest: bool = False):
    """Measure every case."""
    cases = {
        "stickslip --help": (["-m", "stickslip", "--help"], None),
        "stability of 50 spheres": (["-m", "stickslip", "stability", PACKING], 3),
        "snippet of the README": (["-c", readme_snippet()], 3),
        "report of 50 spheres": (["-m", "stickslip", "report", PACKING], None),
        "doctor": (["-m", "stickslip", "doctor"], None),
    }
    for name in EXAMPLES:
        code = f"from benchmarks.first_result import first_result; first_result({name!r})"
        cases[f"run {name}.toml"] = ["-c", code], FLOORS.get(name)
    for case, (words, floor) in list(cases.items())[: 1 if smallest else None]:
        first, again = _time(words), min(_time(words) for _ in range(1 if smallest else 3))
        for start, value, budget in (("first", first, floor), ("again", again, None)):
            ratio = value / budget if budget else None
            yield {
                "case": f"{case}, {start}", "n": 0, "threads": 1, "ours": value, "peer": budget,
                "peer_name": "budget", "ratio": ratio, "unit": "s",
            }  # fmt: skip
