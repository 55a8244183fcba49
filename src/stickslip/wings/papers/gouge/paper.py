"""Reproduction of Ferdowsi & Rubin 2021 at a reduced scale: slide-hold-slide and velocity steps of granular gouge.

The paper, by Ferdowsi and Rubin, uses about 4800 grains, velocities down to 0.2 mm/s and time steps of 20 ns, which
would take months on one core. Here, only a tenth as many grains slide at centimetres per second. The scenario in
`examples/gouge_paper.toml` has the scale of the paper.
"""

from pathlib import Path
from typing import NamedTuple

from ....kit import Claim, Report, Workers, note_quick_run, silent, validate_scenario, within
from .claims import evaluate_claims
from .report import announce, announce_samples
from .scenario import GougeScenario
from .simulate import GougeResult, Sample, check_folder, read_samples, simulate_gouge

SLOW, PAPER = 0.03, 0.02  # velocities before holds; the second is that of Fig S2 [m/s]
DAMPINGS = {  # keys are the names used in claims and figures
    "ε = 0.98, Eq 8": {"restitution": 0.98, "reading": "eq8"},
    "ε = 0.3, Eq 8": {"restitution": 0.3, "reading": "eq8"},
    "ε = 0.98, collision": {"restitution": 0.98, "reading": "collision"},
}
MAIN, LOW, CALIBRATED = DAMPINGS
STIFF = 425.0  # the paper's stiffness, interpreted as k D/σ
STEPS = (1.0, 8.0, 4.0, 1.0, 1.0)  # slips of velocity steps at the paper's size; see `benchmarks/gouge_steps.py` [D]


class Reproduction(NamedTuple):
    """Results by name, and evaluated claims; `holds` has one result per damping value."""

    holds: dict[str, GougeResult]
    more: dict[str, GougeResult]  # results of a full run: "stiff", "reslides", "steps", "velocities"
    claims: list[Claim]

    @property
    def main(self) -> GougeResult:
        """Holds with the damping of the paper, by Eq 8 as printed."""
        return self.holds[MAIN]

    @property
    def results(self) -> dict[str, GougeResult]:
        """All results by name; a result with several names is listed once, under the first."""
        held = list(self.holds.values())
        return self.holds | {name: result for name, result in self.more.items() if not any(result is h for h in held)}


def paper_scenario(
    *, quick: bool = False, paper_size: bool = False, realizations: int | None = None, samples: Path | None = None,
    seed: int = 0, damping: str = MAIN,
) -> GougeScenario:  # fmt: skip
    """Return the scenario of holds after sliding at 0.03 m/s, followed by slides, or the scenario of the paper's size.

    Holds with other damping values are shorter. Without a number of realisations, the scenario is that of the stored
    samples, which `read_samples` checks.
    """
    if not paper_size and (realizations or samples):
        raise ValueError("realisations and samples require paper_size")
    if paper_size:
        if samples and realizations:
            check_folder(samples)
        elif samples:
            realizations = len(stored_samples(samples)[damping])
        return paper_size_scenario(seed, damping, realizations)
    long = damping == MAIN and not quick
    hold = {
        "kind": "slide-hold-slide", "before": (SLOW,), "holds": (1e-2, 1e-1, 1.0) if long else (1e-2, 1e-1),
        "after": () if quick else None, "approach": 1.5 if quick else 4.0, "slip": 0.7, "branches": 2 if quick else 3,
    }  # fmt: skip
    return _scenario(quick, seed, 2 if quick else 8 if long else 4, damping, [hold], ledger_steps=2000 if long else 0)


def full_scenarios(seed: int = 0) -> dict[str, GougeScenario]:
    """Return the additional scenarios of a full run.

    They cover a stiff spring, slides at other velocities after holds, velocity steps, and steady friction.
    """
    hold = {"kind": "slide-hold-slide", "before": (SLOW,), "holds": (1e-2, 1e-1), "approach": 4.0, "slip": 0.7}
    again = {"before": (PAPER,), "holds": (1.43,), "after": (0.02, 0.05, 0.1, 0.3), "branches": 4}
    steps = {"kind": "velocity-steps", "slip": 1.0, "branches": 2}
    slides = [
        {"kind": "slide", "velocity": v, "slip": slip} for v, slip in ((0.1, 4.0), (0.01, 2.0), (0.002, 1.5))
    ]  # fmt: skip
    protocols = {
        "stiff": (4, [hold | {"branches": 2}]),
        "reslides": (4, [hold | again]),
        "steps": (8, [
            steps | {"velocities": (0.3, SLOW, 0.3)}, {"kind": "slide", "velocity": SLOW, "slip": 3.0},
            steps | {"velocities": (SLOW, 0.003, SLOW)},
        ]),
        "velocities": (4, slides),
    }  # fmt: skip
    return {
        name: _scenario(
            False, seed, runs, MAIN, protocol, load={"stiffness": STIFF} if name == "stiff" else {}
        )
        for name, (runs, protocol) in protocols.items()
    }  # fmt: skip


def paper_size_scenario(seed: int = 0, damping: str = MAIN, realizations: int | None = None) -> GougeScenario:
    """Return the scenario of the paper's size: 4341 mobile grains of 1 to 5 mm, and eight samples by default.

    The time step is 16 times that of the paper, half of the longest stable step. Branches start from one state of each
    sample. With a damping other than the paper's, holds are shorter, and no slides follow.
    """
    hold = {"kind": "slide-hold-slide", "before": (PAPER,), "approach": 4.0, "slip": 1.5}
    long = {"holds": (1e-2, 1e-1, 1.0, 1.43), "after": (PAPER, 0.05, 0.1, 0.3)}
    steps = {"kind": "velocity-steps", "velocities": (PAPER, 0.2, PAPER, 0.002, PAPER), "slip": STEPS}
    main = damping == MAIN
    return validate_scenario(
        GougeScenario, seed=seed, realizations=realizations or 8, dt=3.125e-7, sample_every=640, most_steps=1e8,
        grains={"number": 4341, "diameter": (1e-3, 5e-3)}, cell={"length": 0.06, "width": 0.04},
        load={"stiffness": STIFF, "definition": "rate_state"}, law=DAMPINGS[damping] | {"size": 3e-3, "speed": 25.0},
        preparation={"slip": 8.0, "most": 2e6}, ledger_steps=2000 if main else 0,
        protocol=[hold | long, steps] if main else [hold | {"holds": (1e-2, 1e-1), "after": ()}],
    )  # fmt: skip


def stored_samples(folder: Path) -> dict[str, dict[int, Sample]]:
    """Return the samples of the paper's size in a folder, by damping and seed; raises the errors of `read_samples`."""
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder} is not a folder: give the folder of stored samples")
    stored = read_samples(folder, {name: paper_size_scenario(damping=name) for name in (MAIN, LOW)})
    if not stored[MAIN]:
        raise ValueError(f"{folder} has no samples with {MAIN}: add --realizations N to compute N of them")
    return stored


def _scenario(quick: bool, seed: int, runs: int, damping: str, protocol: list, **more) -> GougeScenario:
    return validate_scenario(
        GougeScenario, seed=seed, realizations=runs, dt=4e-7, sample_every=250,
        grains={"number": 300 if quick else 500}, cell={"length": 0.024 if quick else 0.03},
        law=DAMPINGS[damping] | {"size": 3e-3, "speed": 25.0}, preparation={"slip": 4.0 if quick else 8.0},
        protocol=protocol, **more,
    )  # fmt: skip


def reproduce(
    *, quick: bool = False, full: bool = False, paper_size: bool = False, realizations: int | None = None,
    samples: Path | None = None, seed: int = 0, folder: Path | None = None, workers: Workers = None,
    device: str | None = None, report: Report = silent,
) -> Reproduction:  # fmt: skip
    """Run the scenarios and evaluate the claims; the other arguments are those of `simulate_gouge`.

    Parameters
    ----------
    quick : run only holds of 0.1 s with two damping values
    full : also run slides at other velocities after holds, velocity steps, steady friction and a stiff spring
    paper_size : run the scenarios of the paper's size instead
    realizations : number of samples for each of these scenarios; 8 if both this and `samples` are None
    samples : folder with samples of the paper's size. Without `realizations`, the stored samples are evaluated and
        none are run. Otherwise, missing samples are run and added, and all are evaluated.
    """
    names = [MAIN, LOW] if paper_size else [MAIN, CALIBRATED] if quick else list(DAMPINGS)
    size = {"quick": quick, "paper_size": paper_size, "realizations": realizations, "samples": samples}
    chosen = {name: paper_scenario(**size, seed=seed, damping=name) for name in names}
    more = full_scenarios(seed) if full else {}
    if not samples or realizations:
        announce(*chosen.values(), *more.values())

    def run(name, one):
        where = {"folder": folder, "workers": workers, "device": device}
        return simulate_gouge(one, **where, samples=samples, report=within(report, prefix=f"{name}: "))

    if samples:
        before = {path.name for path in samples.glob("*.h5")}
        for name, one in chosen.items() if realizations else ():
            run(name, one)
        stored = stored_samples(samples)
        announce_samples(samples, stored, before)
        holds = {
            name: GougeResult(chosen[name], tuple(one.realization for one in mine.values()), (), len(mine))
            for name, mine in stored.items()
            if mine
        }
    else:
        holds = {name: run(name, scenario) for name, scenario in chosen.items()}
    rest = {name: run(name, scenario) for name, scenario in more.items()}
    if paper_size:
        rest = {"reslides": holds[MAIN], "steps": holds[MAIN]}
    claims = evaluate_claims(holds, rest)
    return Reproduction(holds, rest, note_quick_run(claims) if quick else claims)
