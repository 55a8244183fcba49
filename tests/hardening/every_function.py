"""Calls every public function with invalid arguments, and writes one line of JSON for each call and each fault.

`python -m tests.hardening.every_function SHARE PART START`: from call START on, every call whose number is PART modulo
SHARE. The calls are the same each time. Each argument is in turn every value of `VALUES`, and the right one with a part
of it `altered`; states and laws are in turn those that no function may accept. The system ends the process if a call
takes more than 20 s of processor time; the line that announces the call tells which.
"""

import contextlib
import dis
import inspect
import json
import os
import resource
import signal
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np

import stickslip as ss
from stickslip.figures.claims import Row
from stickslip.wings.status.cone_apex import Apex

PACKAGE = str(Path(ss.__file__).parent)
SECONDS, MEMORY = 20, 4 << 30  # processor time of a call, and address space of the process [bytes]
NAN, OBJECT = float("nan"), object()


# ---- what is given where nothing hostile is

STATE, _ = ss.packings.jammed(8, packing_fraction=0.9, dim=2, seed=1)
LAW = ss.laws.hertz_mindlin(mu=0.5)
BOX, BOX_LAW = ss.packings.biaxial_box(12, pressure=1e-3)
PROTOCOL = ss.protocols.aqs(LAW)
FREE = ss.freedom(STATE)
FRAME = ss.io.frame_of(STATE, LAW)
BLOCKS = ss.modes.contact_blocks(STATE, LAW)[0]
SPECTRUM = ss.spectrum(STATE, LAW)
POINT = ss.results.Equilibrium(0.0, STATE, SPECTRUM, ss.newton(STATE, LAW)[1])
SYSTEM = ss.quasirigid.linear_system(BOX, BOX_LAW)
LOADING = np.linspace(0, 1e-3, len(SYSTEM.free))
PROBLEM = ss.quasirigid.complementarity(SYSTEM, LOADING)
SURFACE = ss.friction.RateState(mu0=0.6, a=0.01, b=0.015, dc=1e-5, v0=1e-6)
SPRING = ss.friction.Spring(stiffness=1e3)
LEGS = ss.friction.velocity_steps([1e-6, 1e-5], distance=1e-4)
FAULT = ss.friction.line_fault(1e3, 100.0, a=0.01, b=0.015, dc=1e-2, normal=5e7)
TIME = np.linspace(0, 1, 20)
STEPPED = ss.friction.velocity_steps([1e-6, 1e-5, 1e-6], distance=6e-5)
HELD = ss.friction.slide_hold_slide([0.3], velocity=1e-3, distance=3e-4)
SLIDER = ss.friction.spring_slider(SURFACE, SPRING, STEPPED, times=np.linspace(0, 60, 60))
NOISE = 1e-5 * np.random.default_rng(0).normal(size=60)
DATA = ss.friction.Data(SLIDER.time, SLIDER.friction + NOISE, STEPPED)
FIT = ss.friction.fit(DATA, fixed={"stiffness": 1e3})
STATIONS = ss.friction.Recording(stations=(0.0, 500.0))
HISTORY = ss.friction.simulate_fault(FAULT, 1e-6, recording=STATIONS)
LAB = ss.friction.LabRecord(TIME, 0.6 + 0 * TIME, 1e-6 * TIME)
LEVEL = ss.scenario(experiment="rate-state")
ARRAY = ss.packings.disk_array(4, press=1e-3, gap=-1e-3)
APEX = Apex(np.eye(2), np.zeros((1, 2)), np.diag([1.0, 0.5])[None], np.ones(1), np.zeros(1), np.zeros(1, bool))
WALL = 12 + ss.packings.TOP
PULLED = ss.quasirigid.with_machine(BOX, WALL, 1.0)
DRIVE, MODE = np.ones((8, 6)) * [1, 1, 0, 0, 0, 1], (np.ones((8, 3)), np.zeros((8, 3)), 1e-3 + 1j)
RECORD = ss.run(STATE, LAW, 3, 1e-2, every=1, probes=[0])[1]

BY_NAME = {
    "state": STATE, "law": LAW, "control": STATE.control, "grains": STATE.grains, "walls": STATE.walls,
    "cell": STATE.cell, "free": FREE, "protocol": PROTOCOL, "path": [POINT, POINT], "blocks": BLOCKS,
    "loads": ss.forces(STATE, LAW)[0], "trial": ss.forces(STATE, LAW)[1], "begin": STATE.control, "end": STATE.control,
    "frame": FRAME, "frames": [FRAME], "matrix": SYSTEM, "load": LOADING, "problem": PROBLEM, "rs": SURFACE,
    "spring": SPRING, "legs": LEGS, "fault": FAULT, "modes": np.eye(len(FREE))[:, :3], "spectra": [SPECTRUM, SPECTRUM],
    "spectrum": SPECTRUM, "index": 0, "steps": 2, "dt": 1e-2, "duration": 0.1, "sample": 0.05, "share": 0.5,
    "bodies": [0], "rate": 1e-3, "force": [0.0, 0.1], "axis": 0, "n_grains": 3, "n_walls": 1, "stress": {"xx": 1e-3},
    "position": STATE.grains.position, "radius": 0.5, "mass": 1.0, "speed": 0.1, "restitution": 0.5, "time": 0.0,
    "times": [0.0, 1.0], "factors": [1.0, 2.0], "displacement": [0.0], "stiffness": 1.0, "young": 1e9, "poisson": 0.3,
    "a": 0, "b": 1, "seed": 1, "velocity": 1e-6, "strain": 1e-3, "gradient": [[1e-3, 0], [0, 0]], "push": 1e-5,
    "press": 1e-3, "n": 8, "shear_rate": 1e-3, "pressure": 1e-2, "diameter": 1.0, "density": 1.0, "step": 1e-3,
    "turning_points": [0.0, 1e-2], "normal_stress": 1e-3, "plate": [0, 1], "translation": np.zeros((8, 3)),
    "rotation": np.zeros((8, 3)), "exponent": 1e-3 + 1j, "number": 1, "wall": 0, "factor": 1.1, "to": 1e-3, "drag": 0.1,
    "near": 0.5, "title": "title", "states": STATE, "mu": 0.5, "packing_fraction": 0.7, "modulus": 3e10, "dc": 1e-2,
    "normal": 5e7, "width": 1e3, "distance": 1e-4, "velocities": [1e-6, 1e-5], "holds": [1.0, 10.0], "values": TIME,
    "hold": [1.0, 10.0, 100.0], "excess": [0.01, 0.02, 0.03], "load_point": TIME, "friction": TIME, "record": LAB,
    "data": DATA, "first": FIT, "second": FIT, "log_velocity": 0.0, "history": HISTORY, "years": 1e-6,
    "text": "1e-6 until 0.5, 1e-5", "workers": 1, "function": divmod, "tasks": [(3, 2)], "task": (3, 2), "seconds": 5.0,
    "name": "gouge.toml", "folder": "made", "scenario": LEVEL, "waves": ss.modes.dispersion(STATE, LAW),
    "field": ss.modes.inflate(STATE, LAW, 0), "envelopes": [ss.protocols.response_envelope(STATE, LAW, directions=4)],
    "labels": ["a"], "position_error": 1e-9, "work": 1e-3, "surface_tension": 1e-3, "volume": 1e-3, "k_unload": 2.0,
    "arm": "branch", "of": "force", "before": STATE, "after": STATE, "frequency": 0.1, "direction": [1.0, 0.0],
    "wavevector": [1.0, 0.0], "contact": 0, "drive": np.ones(len(FREE)), "msd": 1e-15 * np.exp(TIME),
    "growth_rate": 0.5, "stresses": np.ones((1, len(SYSTEM.free))), "until": 1.0, "travel": [1e-3, 0, 0], "apex": APEX,
    "place": "nowhere", "units": "SI", "rows": [Row("a", "b", "reproduced", (0.5,), 0.1, "1", "1", False)],
    "measured": ss.io.measured_forces([[0, 0], [1.01, 0]], 0.5, [0], [1], [0.1], held=[0, 1]),
    "source": STATE,
}  # fmt: skip
STEPS = np.zeros(len(FREE))
GOOD = {
    "displaced": {"step": STEPS}, "control.spring_forces": {"position": STATE.grains.position},
    "control.spring_loaded": {"position": [[0, 0, 0]]}, "control.strained_at": {"rate": np.zeros((3, 3))},
    "quasirigid.linear_system": {"state": BOX, "law": BOX_LAW}, "quasirigid.load_path": {"state": BOX, "law": BOX_LAW},
    "quasirigid.quadratic_form": {"velocity": LOADING}, "quasirigid.slow_dynamics": {"time": 1.0},
    "quasirigid.with_load": {"control": BOX.control, "wall": WALL},
    "quasirigid.with_machine": {"state": BOX, "wall": WALL},
    "quasirigid.with_travel": {"control": PULLED.control, "wall": WALL},
    "quasirigid.probe_statuses": {"stresses": np.eye(2)[None]},
    "modes.displaced": {"step": STEPS}, "modes.frequency_response": {"drive": DRIVE},
    "modes.trigger_amplitude": {"drive": DRIVE, "frequency": 0.1, "dynamics": False},
    "modes.modulus_gradient": {"strain": np.eye(2)},
    "modes.plane_wave": {"wavevector": ss.modes.allowed_wavevectors(STATE)[0]},
    "modes.stationary_fluctuations": {"drag": 0.1, "spin_drag": 0.1},
    "packings.jammed": {"tolerance": 1e-6, "pressure": None, "packing_fraction": 0.7},
    "packings.compressed": {"n": 30, "pressure": 1e-2, "tolerance": 1e-6, "mu": 0.5},
    "packings.from_arrays": {"radius": np.full(8, 0.1)}, "packings.without_walls": {"state": BOX, "walls": [0]},
    "packings.biaxial_box": {"n": 10}, "packings.sheared_box": {"n": 10},
    "protocols.find_events": {"step": 0.5}, "protocols.fit_growth": {"time": TIME},
    "protocols.ramp": {"loads": [0.0, 1e-4]},
    "protocols.kinetic_threshold": {
        "duration": 4.0, "dt": 0.1, "realizations": 1, "ramps": 0, "kicks": [1e-3], "loads": [0.0],
    },
    "protocols.run_batch": {"states": [STATE]}, "protocols.shear_to_failure": {"step": 0.5},
    "friction.prescribed": {"time": TIME, "velocity": 1e-6 + 0 * TIME[1:]},
    "friction.line_fault": {"cell": 100.0, "normal": 5e7, "a": 0.01, "b": 0.015},
    "friction.hold_response": {"legs": HELD, "time": TIME}, "friction.load_steps": {"time": TIME},
    "friction.stated_steps": {"time": TIME}, "friction.find_steps": {"time": TIME},
    "friction.cohesive_length": {"b": 0.015}, "friction.nucleation_half_length": {"a": 0.01, "b": 0.015},
    "friction.critical_wavelength": {"a": 0.01, "b": 0.015}, "friction.fit": {"fixed": {"stiffness": 1e3}},
    "friction.write_csv": {"path": "made.csv"}, "io.write_packing": {"path": "made.npz", "law": LAW},
    "friction.perturbed_state": {"state": HISTORY.state},
    "friction.simulate_fault": {"start": HISTORY.state},
    "figures.bursts": {"record": RECORD}, "figures.packing": {"mode": MODE}, "figures.view": {"modes": [MODE]},
    "figures.movie": {"path": "made.gif"},
    "figures.rate_state.cycles": {"since": TIME, "curves": np.ones((3, len(TIME))), "recurrence": [1.0, 2.0]},
    "io.measured_forces": {
        "position": [[0, 0], [1.01, 0]], "pair_i": [0], "pair_j": [1], "force_n": [0.1], "held": [0, 1],
    },
    "io.mode_frames": {"translation": np.ones((8, 3))}, "io.contact_table": {"data": OBJECT},
    "laws.custom": {"normal_force": lambda overlap: overlap}, "laws.with_lever": {"arm": "radius"},
    "laws.with_rolling": {"k_roll": 0.1, "mu_roll": 0.1}, "laws.with_twisting": {"k_twist": 0.1},
    "measure.coarse_grained": {"width": 0.5}, "experiments.flow.deposit": {"loose": [0, 1]},
}  # fmt: skip


def functions():
    """Names and values of all public functions."""
    spaces = [(ss, "")]
    for module, prefix in spaces:
        own = [name for name, value in vars(module).items() if getattr(value, "__module__", "") == module.__name__]
        for name in getattr(module, "__all__", [name for name in own if not name.startswith("_")]):
            value = getattr(module, name)
            if inspect.isfunction(value):
                yield prefix + name, value
            elif inspect.ismodule(value):
                spaces.append((value, f"{prefix}{name}."))


# ---- what is hostile


def short(value) -> str:
    return f"array {value.shape} of {value.flat[0]:g}" if isinstance(value, np.ndarray) else repr(value)


def states():
    """States that no function may accept, by what is wrong with them."""

    def part(noun, **entries):
        return STATE._replace(**{noun: getattr(STATE, noun)._replace(**entries)})

    def entry(noun, name, value, at=0):
        array = np.array(getattr(getattr(STATE, noun), name))
        array.reshape(-1)[at] = value
        return part(noun, **{name: array})

    for name in ("radius", "mass", "inertia"):
        for value in (0.0, -1.0, NAN, np.inf):
            yield f"{name} {value}", entry("grains", name, value)
    for name in ("position", "angle", "velocity", "spin"):
        yield f"{name} NaN", entry("grains", name, NAN)
    for noun, name in (("contacts", "slip"), ("contacts", "pair"), ("contacts", "roll"), ("contacts", "origin")):
        yield f"{name} NaN", entry(noun, name, NAN)
    for name in ("force", "rate", "gravity", "stress", "spring", "anchor"):
        yield f"{name} NaN", entry("control", name, NAN)
    yield "spring −1", entry("control", "spring", -1.0)
    for name, value in (("mode", 99), ("i", 10**6), ("j", 10**6), ("j", -1), ("image", 100), ("key", 7)):
        yield f"{name} {value}", entry("contacts", name, value)
    for value in (10**6, -1):
        yield f"count {value}", part("contacts", count=np.array([value]))
    for name, value in (("group", 10**6), ("group", -5), ("follows", 5), ("leads", 5), ("cell_follows", 5)):
        yield f"{name} {value}", entry("control", name, value)
    for value in (NAN, -1.0, np.zeros((3, 3)), "heavy"):
        yield f"cell_mass {short(value)}", part("control", cell_mass=value)
    for value in ("now", NAN, None, np.zeros(2)):
        yield f"time {short(value)}", STATE._replace(time=value)
    for name, value in (("dim", 4), ("dim", "2"), ("periodic", np.ones(3)), ("vectors", np.zeros((3, 3)))):
        yield f"{name} {short(value)}", part("cell", **{name: value})
    for name, value in (("skin", NAN), ("skin", -1.0), ("gap", -1.0), ("stale", None), ("rolling", np.zeros((1, 7)))):
        yield f"{name} {short(value)}", part("contacts", **{name: value})
    yield "material −1", entry("grains", "material", -1)
    yield "radius of another type", part("grains", radius=STATE.grains.radius.astype(np.float32))
    yield "radius a list", part("grains", radius=STATE.grains.radius.tolist())
    yield "positions missing", part("grains", position=STATE.grains.position[:-1])
    yield "positions in the plane", part("grains", position=STATE.grains.position[:, :2])
    yield "no contacts", STATE._replace(contacts=None)
    yield "no grains", STATE._replace(grains=None)
    yield "control of others", STATE._replace(control=ss.control.loads(3))
    yield "contacts of others", STATE._replace(contacts=BOX.contacts)


def laws():
    for name, value in (
        ("kind", 99), ("kind", "x"), ("coulomb", 7), ("damping", 77), ("table", None), ("table", np.ones((1, 1, 2))),
        ("table", np.full((1, 1, 5), NAN)), ("table", -np.ones((1, 1, 5))), ("table", np.ones((1, 2, 5))),
    ):  # fmt: skip
        yield f"{name} {short(value)}", LAW._replace(**{name: value})


def results():
    """Invalid results by the argument that takes them."""
    loads = BY_NAME["loads"]
    yield "free", "of others", ss.freedom(BOX)
    entries = FREE._asdict()
    yield "free", "short", type(FREE)(**entries | {"place": FREE.place[:-1]})
    yield "free", "out of range", type(FREE)(**entries | {"component": FREE.component + 10**6})
    yield "loads", "of others", ss.forces(BOX, BOX_LAW)[0]
    yield "loads", "NaN", loads._replace(force=np.full_like(loads.force, NAN))
    yield "trial", "of others", BOX.contacts
    yield "path", "invalid state", [POINT._replace(state=STATE._replace(time=NAN))]
    yield "frames", "invalid state", [FRAME._replace(state=STATE._replace(time=NAN))]
    yield "frame", "invalid state", FRAME._replace(state=STATE._replace(time=NAN))


VALUES = {
    "None": None, "word": "x", "empty word": "", "NaN": NAN, "inf": np.inf, "−1": -1, "0": 0, "denormal": 1e-320,
    "huge": 1e300, "fraction": 0.5, "long": 10**30, "complex": 1j, "True": True, "[]": [], "[NaN]": [NAN],
    "ragged": [[1.0], [2.0, 3.0]], "words": ["a", "b"], "array": np.arange(3.0), "no rows": np.zeros((0, 3)),
    "block": np.zeros((2, 2, 2)), "0-d": np.array(0.5), "{}": {}, "object": OBJECT, "tuple": (1, 2, 3),
    "dates": np.array(["2020"], "M8[Y]"), "2**31": 2**31, "−2**63": -(2**63), "lowest": -1e-320, "NUL": "a\0b",
    "long word": "x" * 5000, "bytes": b"x", "one": [1.0], "small vector": [1e-320, 0.0], "None inside": [None],
    "set": {1, 2}, "keys": {"x": 1e300}, "bits": np.array([True, False]),
}  # fmt: skip


def arguments_of(name, function):
    """Valid arguments of a function as far as they are known, and its parameters of any number."""
    given, variable, pool = {}, [], GOOD.get(name, {})
    for parameter in inspect.signature(function).parameters.values():
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            variable.append(parameter)
        elif parameter.name in pool:
            given[parameter.name] = pool[parameter.name]
        elif parameter.annotation == str | Path:
            given[parameter.name] = "packing.npz"
        elif parameter.default is parameter.empty:  # an object if no valid value is at hand: only wrong ones are tried
            given[parameter.name] = BY_NAME.get(parameter.name, OBJECT)
    return given, variable


def calls():
    """Name, function, arguments, and whether the call has to be refused, of every call."""
    bad = {"state": list(states()), "law": list(laws())}
    for key, what, value in results():
        bad.setdefault(key, []).append((what, value))
    for name, function in functions():
        given, variable = arguments_of(name, function)
        names = [
            *(key for key, parameter in inspect.signature(function).parameters.items() if parameter not in variable)
        ]
        for key in names:
            for what, value in bad.get(key, ()):
                yield f"{name}({key} = {what})", function, given | {key: value}, True
            for what, value in [*VALUES.items(), *altered(given.get(key))]:
                yield f"{name}({key} = {what})", function, given | {key: value}, False
        for parameter in variable:
            if parameter.kind is parameter.VAR_KEYWORD:
                for what, value in VALUES.items():
                    yield f"{name}(**{{'mu': {what}}})", function, given | {"mu": value}, False


def altered(value):
    """A value with a part of it replaced, by what was done: a field, an entry, the length, the type of numbers."""
    if hasattr(value, "_replace") and not isinstance(value, ss.State | ss.Law):  # these are in `states` and `laws`
        entries = value._asdict()  # `_replace` needs the length of a `Freedom`
        for name, part in entries.items():
            for what in ("None", "word", "NaN", "−1", "2**31", "[]", "object", "no rows", "array"):
                yield f".{name} {what}", type(value)(**entries | {name: VALUES[what]})
            for what, other in altered(part) if isinstance(part, np.ndarray) else ():
                yield f".{name} {what}", type(value)(**entries | {name: other})
    elif isinstance(value, np.ndarray) and value.size:
        yield from (("shorter", value[:-1]), ("longer", np.concatenate([value, value[:1]])), ("row", value[None]))
        if value.dtype.kind in "fi":
            for what, entry in (("NaN", NAN), ("huge", 1e300), ("−1", -1.0), ("2**31", 2.0**31)):
                changed = value.astype(float)
                changed.reshape(-1)[0] = entry
                yield f"[0] {what}", changed if value.dtype.kind == "f" or entry != entry else changed.astype(int)
    elif isinstance(value, list | tuple) and value and not hasattr(value, "_fields"):
        for what in ("None", "word", "NaN", "−1", "2**31", "object"):
            yield f"[0] {what}", type(value)([VALUES[what], *value[1:]])
        for what, other in altered(value[0]):
            yield f"[0]{what}", type(value)([other, *value[1:]])


# ---- the calls


def fault_of(function, arguments, refused: bool) -> str:
    """What is wrong with the outcome of a call; empty if nothing is."""
    try:
        made = function(**arguments)
        if inspect.isgenerator(made):
            next(made, None)
    except Exception as error:
        return _fault_of_error(error)
    return "accepted" if refused else ""


def _fault_of_error(error: Exception) -> str:
    """An error is ours if a `raise` statement of this package raised it, with one sentence."""
    last = error.__traceback__
    while last.tb_next is not None:
        last = last.tb_next
    message, place = str(error), last.tb_frame.f_code
    by_raise = dis.opname[place.co_code[last.tb_lasti]] == "RAISE_VARARGS"
    ours = isinstance(error, ValueError | TypeError | RuntimeError) or type(error).__module__.startswith("stickslip")
    if isinstance(error, OSError) and error.filename:  # of the file system, with the path
        return ""
    if ours and by_raise and place.co_filename.startswith(PACKAGE) and message and "\n" not in message:
        return ""
    return f"{type(error).__name__}: {message[:200]} [{os.path.relpath(place.co_filename, PACKAGE)}:{last.tb_lineno}]"


def main(share: int, part: int, start: int) -> None:
    warnings.simplefilter("ignore")
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    tell, silent = os.fdopen(os.dup(1), "w"), os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 1)
    os.dup2(silent, 2)
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        ss.io.write_packing("packing.npz", STATE, LAW)
        for number, (name, function, arguments, refused) in enumerate(calls()):
            if number < start or number % share != part:
                continue
            print(json.dumps([number, name, None]), file=tell, flush=True)
            signal.setitimer(signal.ITIMER_PROF, SECONDS)
            fault = fault_of(function, arguments, refused)
            signal.setitimer(signal.ITIMER_PROF, 0)
            if fault:
                print(json.dumps([number, name, fault]), file=tell, flush=True)
    print(json.dumps([-1, "end", None]), file=tell, flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
