"""Types of results, for annotations and `isinstance`; the function that returns each is in parentheses.

Stability: Spectrum (spectrum), Stability (stability), ComplexPairs, FastestPair, ContactSensitivity, DampedStability,
    DensityOfStates, ElasticModuli, TransientGrowth (functions of `modes`), Freedom (freedom), Factorisation (newton)
Loading: ContactLoads (forces), Equilibrium (protocols.ramp), Released (protocols.release),
    PackingInfo (packings.jammed), Poured (packings.poured), Ledger (run), Collision (laws.collision)
Quasi-rigidity: LinearSystem, ContactStatus, Verdict, Complementarity, Apex, Mechanism, Uniqueness, LoadPath, SlowRun
Friction: SlipHistory (friction.spring_slider), Fit (friction.fit), LawComparison (friction.compare_laws)
Experiments: DiskArrayResult, ShearResult, ShearPath, QuasiResult, GougeResult, FlowResult, FlowSeries, Deposit,
    PlaneShear, SliderResult, Sweep
"""

from .core.contacts.forces import ContactLoads
from .core.dynamics.ledger import Ledger
from .experiments.disk_array.simulate import DiskArrayResult
from .experiments.flow.measures import Deposit, PlaneShear
from .experiments.flow.pouring import Poured
from .experiments.flow.simulate import FlowResult, FlowSeries
from .experiments.gouge.simulate import GougeResult
from .experiments.quasi_rigid.simulate import QuasiResult
from .experiments.rate_state.simulate import SliderResult
from .experiments.sphere_shear.simulate import ShearPath, ShearResult
from .experiments.sweep.definition import Sweep
from .friction.fitting import Fit
from .friction.model_comparison import LawComparison
from .friction.ratestate import SlipHistory
from .lazy import unknown
from .loading.packing import PackingInfo as PackingInfo
from .loading.protocols import Equilibrium
from .loading.release import Released
from .loading.slow import SlowRun
from .quasirigid.cone_apex import Apex
from .quasirigid.lcp import Complementarity
from .quasirigid.matrices import LinearSystem
from .quasirigid.null_modes import Mechanism
from .quasirigid.path import LoadPath
from .quasirigid.status import ContactStatus, Verdict
from .quasirigid.uniqueness import Uniqueness
from .solve.collision import Collision
from .solve.damped import DampedStability
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
    "Collision",
    "Complementarity",
    "ComplexPairs",
    "ContactLoads",
    "ContactSensitivity",
    "ContactStatus",
    "DampedStability",
    "DensityOfStates",
    "Deposit",
    "DiskArrayResult",
    "ElasticModuli",
    "Equilibrium",
    "Factorisation",
    "FastestPair",
    "Fit",
    "FlowResult",
    "FlowSeries",
    "Freedom",
    "GougeResult",
    "LawComparison",
    "Ledger",
    "LinearSystem",
    "LoadPath",
    "Mechanism",
    "PackingInfo",
    "PlaneShear",
    "Poured",
    "QuasiResult",
    "Released",
    "ShearPath",
    "ShearResult",
    "SliderResult",
    "SlipHistory",
    "SlowRun",
    "Spectrum",
    "Stability",
    "Sweep",
    "TransientGrowth",
    "Uniqueness",
    "Verdict",
]

__getattr__ = unknown(__name__)
