"""Types of results, for annotations and `isinstance`, with the functions that return them.

Stability
    Spectrum, Stability     `spectrum`, `stability`
    ComplexPairs, FastestPair, BirthForm    functions of `modes` for complex pairs
    ContactSensitivity, DensityOfStates, ElasticModuli, TransientGrowth     other functions of `modes`
    Freedom, Factorisation  `freedom`, `newton`

Loading
    ContactLoads            `forces`
    Equilibrium, Released, KineticThreshold     `protocols.ramp`, `protocols.release`, `protocols.kinetic_threshold`
    Event, EventKind, Events, StrainStep        `protocols.find_events`
    PackingInfo, Poured     `packings.jammed` and `packings.compressed`; `packings.poured`
    Record, Ledger          `run`
    Collision               `laws.collision`

Quasi-rigidity
    LinearSystem, ContactStatus, Verdict, Complementarity, Apex     functions of `quasirigid`
    Mechanism, Uniqueness, LoadPath, SlowRun    functions of `quasirigid`
    StatusSolution, StatusMap       `quasirigid.statuses_at_apex`, `quasirigid.status_map`

Friction
    SlipHistory             `friction.spring_slider`
    Fit, Posterior, LawComparison   `friction.fit`, `friction.posterior`, `friction.compare_laws`
    Sliding, Mean, Healing, HoldResponse, Nucleation    functions of `friction`
    FaultHistory, FaultEvents       `friction.simulate_fault`

Experiments
    CatalogueResult, DiskArrayResult, ShearResult, ShearPath, QuasiResult, GougeResult  `simulate`
    FlowResult, FlowSeries, Deposit, PlaneShear, SliderResult, FaultResult, ThresholdResult     `simulate`
    Sweep, SweepResult      `sweep`, `run_sweep`

Files
    Frame                   `io.frame_of`
"""

from .core.contacts.forces import ContactLoads
from .core.dynamics.ledger import Ledger
from .core.dynamics.record import Record
from .data.exchange.frame import Frame
from .experiments.catalogue.simulate import CatalogueResult
from .experiments.disk_array.simulate import DiskArrayResult
from .experiments.fault.simulate import FaultResult
from .experiments.flow.measures import Deposit, PlaneShear
from .experiments.flow.pouring import Poured
from .experiments.flow.simulate import FlowResult, FlowSeries
from .experiments.gouge.simulate import GougeResult
from .experiments.quasi_rigid.simulate import QuasiResult
from .experiments.rate_state.simulate import SliderResult
from .experiments.sphere_shear.simulate import ShearPath, ShearResult
from .experiments.sweep.definition import Sweep
from .experiments.sweep.run import SweepResult
from .experiments.threshold.simulate import ThresholdResult
from .friction.fault_cycles import FaultHistory
from .friction.fault_record import FaultEvents
from .friction.fault_theory import Nucleation
from .friction.fitting import Fit
from .friction.measure import Healing, HoldResponse, Mean
from .friction.model_comparison import LawComparison
from .friction.ratestate import SlipHistory
from .friction.sampling import Posterior
from .friction.stability import Sliding
from .lazy import unknown
from .loading.event_types import Event, EventKind, Events, StrainStep
from .loading.packing import PackingInfo as PackingInfo
from .loading.protocols import Equilibrium
from .loading.release import Released
from .loading.slow import SlowRun
from .loading.threshold import KineticThreshold
from .quasirigid.cone_apex import Apex, StatusSolution
from .quasirigid.enumeration import StatusMap
from .quasirigid.lcp import Complementarity
from .quasirigid.matrices import LinearSystem
from .quasirigid.null_modes import Mechanism
from .quasirigid.path import LoadPath
from .quasirigid.status import ContactStatus, Verdict
from .quasirigid.uniqueness import Uniqueness
from .solve.birth import BirthForm
from .solve.collision import Collision
from .solve.density import DensityOfStates
from .solve.fastest import FastestPair
from .solve.freedom import Freedom
from .solve.moduli import ElasticModuli
from .solve.newton import Factorisation
from .solve.pairs import ComplexPairs
from .solve.sensitivity import ContactSensitivity
from .solve.spectrum import Spectrum
from .solve.stability import Stability
from .solve.transient import TransientGrowth

__all__ = [
    "Apex",
    "BirthForm",
    "CatalogueResult",
    "Collision",
    "Complementarity",
    "ComplexPairs",
    "ContactLoads",
    "ContactSensitivity",
    "ContactStatus",
    "DensityOfStates",
    "Deposit",
    "DiskArrayResult",
    "ElasticModuli",
    "Equilibrium",
    "Event",
    "EventKind",
    "Events",
    "Factorisation",
    "FastestPair",
    "FaultEvents",
    "FaultHistory",
    "FaultResult",
    "Fit",
    "FlowResult",
    "FlowSeries",
    "Frame",
    "Freedom",
    "GougeResult",
    "Healing",
    "HoldResponse",
    "KineticThreshold",
    "LawComparison",
    "Ledger",
    "LinearSystem",
    "LoadPath",
    "Mean",
    "Mechanism",
    "Nucleation",
    "PackingInfo",
    "PlaneShear",
    "Posterior",
    "Poured",
    "QuasiResult",
    "Record",
    "Released",
    "ShearPath",
    "ShearResult",
    "SliderResult",
    "Sliding",
    "SlipHistory",
    "SlowRun",
    "Spectrum",
    "Stability",
    "StatusMap",
    "StatusSolution",
    "StrainStep",
    "Sweep",
    "SweepResult",
    "ThresholdResult",
    "TransientGrowth",
    "Uniqueness",
    "Verdict",
]

__getattr__ = unknown(__name__)
