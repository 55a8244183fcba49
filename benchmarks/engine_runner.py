"""Run one side of the engine benchmark in its own process: `engine_runner.py SIDE SCENE STEPS THREADS [RUNS]`.

Prints seconds per step. With RUNS, this is the mean over that many runs from one state, each without the time of a run
of one step. The side `threads` prints seconds per step on one thread, on THREADS threads, and half the time of two
simultaneous runs; with RUNS, these times include the start and end of a run (see `alternate`). The side `widths` prints
seconds per step and closed contact of several scenes.

All sides use the same grains, velocities, law (Hertz–Mindlin with memory, k_n = 2, k_t = 4/7 with √R_eff, μ = 1/2, no
dashpots), box and time step. Each code checks neighbours and rebuilds lists in its own way, with the skin at which it
was fastest.
"""

import multiprocessing
import os
import sys
import time

import numpy as np

WARM, TURNS = 100, 40


def load_scene(scene):
    """State, law and time step."""
    import stickslip as ss

    law, dt = ss.laws.hertz_mindlin_reff(2.0, 4 / 7, 0.5), float(scene["dt"])
    dim, size = int(scene["dim"]), scene["size"]
    make = ss.disks if dim == 2 else ss.spheres
    grains = make(scene["position"], scene["radius"], mass=scene["mass"], velocity=scene["velocity"])
    box = ss.box([size, size, size if dim == 3 else 1.0], [True, True, dim == 3], dim)
    return ss.assembly(grains, cell=box, skin=0.2), law, dt


def warm_up(state, law, dt, threads: int):
    """Return the state after the first steps, which are not timed."""
    import stickslip as ss

    return ss.run(state, law, WARM, dt, threads=threads)[0]


def seconds_per_step(state, law, dt, steps: int, threads: int) -> float:
    """Seconds per step of one run of stickslip."""
    import stickslip as ss

    start = time.perf_counter()
    ss.run(state, law, steps, dt, threads=threads)
    return (time.perf_counter() - start) / steps


def ours(scene, steps: int, threads: int, runs: int = 0) -> float:
    """Seconds per step of stickslip; with `runs`, the mean of that many runs, without their start and end."""
    state, law, dt = load_scene(scene)
    state = warm_up(state, law, dt, threads)
    if not runs:
        return seconds_per_step(state, law, dt, steps, threads)
    found = [
        steps * seconds_per_step(state, law, dt, steps, threads) - seconds_per_step(state, law, dt, 1, threads)
        for _ in range(runs)
    ]
    return sum(found) / (runs * (steps - 1))


def second_process(path: str, pipe) -> None:
    """Second process: on each request, run the requested number of steps on one thread."""
    state, law, dt = load_scene(dict(np.load(path)))
    state = warm_up(state, law, dt, 1)
    pipe.send(0.0)
    while steps := pipe.recv():
        pipe.send(steps * seconds_per_step(state, law, dt, steps, 1))


def alternate(path: str, steps: int, threads: int, whole: bool) -> list[float]:
    """Seconds per step on one thread, on `threads`, and half the longer time of two simultaneous one-thread runs.

    All runs start from the same state and alternate; the best of several counts, without the start and end of a run
    unless `whole`. Turns are short and many, because threads are as fast as the slowest core, and shared cores are
    seldom all idle at the same time. Two independent runs show the maximum that the machine can provide.
    """
    state, law, dt = load_scene(dict(np.load(path)))
    states = [(warm_up(state, law, dt, count), count) for count in (1, threads)]
    best, (here, there) = np.full((2, 3), np.inf), multiprocessing.Pipe()
    other = multiprocessing.get_context("spawn").Process(target=second_process, args=(path, there), daemon=True)
    other.start()
    here.recv()
    for _ in range(TURNS):
        for row, number in zip(best, (steps, 1), strict=True):
            found = [number * seconds_per_step(one, law, dt, number, count) for one, count in states]
            here.send(number)
            mine = number * seconds_per_step(states[0][0], law, dt, number, 1)
            row[:] = np.minimum(row, [*found, max(mine, here.recv()) / 2])
    here.send(0)
    other.join()
    return list(best[0] / steps if whole else (best[0] - best[1]) / (steps - 1))


def widths(paths: str, steps: int) -> list[float]:
    """Seconds per step and closed contact of several alternating scenes, best of several, without start and end."""
    scenes = [load_scene(dict(np.load(path))) for path in paths.split(os.pathsep)]
    states = [(warm_up(state, law, dt, 1), law, dt) for state, law, dt in scenes]
    best = np.full((len(states), 2), np.inf)
    for _ in range(TURNS):
        for row, one in zip(best, states, strict=True):
            row[:] = np.minimum(row, [number * seconds_per_step(*one, number, 1) for number in (steps, 1)])
    closed = [np.count_nonzero(state.contacts.mode[: state.contacts.count[0]]) for state, *_ in states]
    return list((best[:, 0] - best[:, 1]) / (steps - 1) / closed)


def lammps(style: str, scene, steps: int, threads: int) -> float:
    """Seconds per step of LAMMPS with a pair style; styles that end in " omp" use package OPENMP with newton on."""
    from lammps import lammps as code

    dim, size, n = int(scene["dim"]), float(scene["size"]), len(scene["radius"])
    styles = {
        "gran/hertz/history": ("gran/hertz/history 2.0 0.5714285714285714 0.0 0.0 0.5 0", "* *"),
        "granular": ("granular", "* * hertz 2.0 0.0 tangential mindlin 0.5714285714285714 0.0 0.5 damping velocity"),
    }
    style, _, omp = style.partition(" ")
    pair, coeff = styles[style]
    depth = size if dim == 3 else 0.5
    more = ["-sf", "omp", "-pk", "omp", str(threads)] if omp else []
    lmp = code(cmdargs=["-screen", "none", "-log", "none", *more])
    lmp.commands_string(f"""
        units lj
        atom_style sphere
        dimension {dim}
        boundary p p p
        newton {"on" if omp else "off"}
        comm_modify vel yes
        region box block 0 {size} 0 {size} {0 if dim == 3 else -0.5} {depth}
        create_box 1 box
        neighbor 0.1 bin
        neigh_modify delay 0 every 1 check yes
        pair_style {pair}
        pair_coeff {coeff}
        fix move all nve/sphere {"disc" if dim == 2 else ""}
        {"fix plane all enforce2d" if dim == 2 else ""}
        timestep {float(scene["dt"])}
        thermo 0
    """)
    lmp.create_atoms(
        n,
        list(range(1, n + 1)),
        [1] * n,
        (scene["position"] % size).ravel().tolist(),
        scene["velocity"].ravel().tolist(),
    )
    order = lmp.numpy.extract_atom("id")[:n] - 1
    lmp.numpy.extract_atom("radius")[:n] = scene["radius"][order]
    lmp.numpy.extract_atom("rmass")[:n] = scene["mass"][order]
    lmp.command(f"run {WARM} post no")
    start = time.perf_counter()
    lmp.command(f"run {steps} post no")
    return (time.perf_counter() - start) / steps


def main() -> None:
    """Run the side given on the command line."""
    (side, path), (steps, threads, *runs) = sys.argv[1:3], map(int, sys.argv[3:])
    if side == "threads":
        print(*alternate(path, steps, threads, any(runs)))
        return
    if side == "widths":
        print(*widths(path, steps))
        return
    scene = dict(np.load(path))
    print(ours(scene, steps, threads, *runs) if side == "ours" else lammps(side, scene, steps, threads))


if __name__ == "__main__":
    main()
