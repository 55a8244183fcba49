"""Types of results, for annotations and `isinstance`, with the functions that return them.

Types of an experiment are in its namespace, such as `experiments.flow.FlowResult`.

Stability
    Spectrum, Stability     `spectrum`, `stability`
    ComplexPairs, FastestPair, BirthForm    functions of `modes` for complex pairs
    ContactSensitivity, DensityOfStates, ElasticModuli, TransientGrowth     other functions of `modes`
    FirstBreak, DecisiveBonds       `modes.first_break`, `modes.decisive_bonds`
    Inflation, ScreeningFits        `modes.inflate` and `protocols.inflate`, `Inflation.fit`
    EquationsOfMotion, Freedom, Factorisation  `freedom`, `newton`

Loading
    ContactLoads            `forces`
    Equilibrium, Released, KineticThreshold     `protocols.ramp`, `protocols.release`, `protocols.kinetic_threshold`
    Localisation            `protocols.localisation`
    Event, EventKind, Events, StrainStep        `protocols.find_events`
    Failure, PathStep, PairLife, Forecast       `protocols.shear_to_failure`
    PackingInfo, Poured     `packings.jammed` and `packings.compressed`; `packings.poured`
    Record, Ledger          `run`
    Collision               `laws.collision`
    Deposit, PlaneShear     `experiments.flow.deposit`, `experiments.flow.plane_shear`

Quasi-rigidity
    LinearSystem, ContactStatus, Verdict, Complementarity, Apex     functions of `quasirigid`
    Mechanism, Uniqueness, LoadPath, SlowRun    functions of `quasirigid`
    StatusSolution, StatusMap       `quasirigid.statuses_at_apex`, `quasirigid.status_map`

Friction
    SlipHistory             `friction.spring_slider`
    Fit, Posterior, LawComparison   `friction.fit`, `friction.posterior`, `friction.compare_laws`
    Sliding, Mean, Healing, HoldResponse, Nucleation    functions of `friction`
    FaultHistory, FaultEvents       `friction.simulate_fault`

Sweeps
    Sweep, SweepResult      `sweep`, `run_sweep`

Files
    Frame                   `io.frame_of`
"""

from .lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
