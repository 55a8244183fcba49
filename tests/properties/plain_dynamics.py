"""Slow, obvious twin of `run`: plain Python, one contact at a time, written from the documentation.

Pairs are found by brute force over all images, memory is a dictionary, and only names of parameters are taken
from the package. The twin makes the steps that `docs/engine.md`, the theory pages `engine` and `contacts`, and the
docstrings of `run` and `cell_motion` describe, with the same discretisation, so that it agrees with `run` to round-off.
"""

import inspect
from typing import NamedTuple

import numpy as np

from stickslip.core.laws.builtin import parameter_names

OPEN, STICK, SLIDE = 0, 1, 2
ROUND_OFF = 1e-13
VELOCITY, MASS, VISCOELASTIC, NO_TENSION = 1, 2, 3, 4
DASHPOTS = {"velocity": VELOCITY, "mass_velocity": MASS, "viscoelastic": VISCOELASTIC}
ONE = np.eye(3)


class PlainLaw(NamedTuple):
    """Functions (overlap, r_eff, q) and (normal force, overlap, r_eff, q), with q a dictionary of parameters."""

    normal_force: object
    tangential_stiffness: object
    cap: object
    reach: object = lambda r_eff, q: 0.0
    rolling_stiffness: object = None
    rolling_cap: object = None
    rescaled: bool = False
    across_gaps: bool = False


def _coulomb_cap(fn, overlap, r_eff, q):
    return q["mu"] * max(fn, 0.0)


BUILTIN = {
    "hertz_mindlin": PlainLaw(lambda d, r, q: q["kn"] * d**1.5, lambda d, r, q: q["kt"] * d**0.5, _coulomb_cap),
    "linear": PlainLaw(lambda d, r, q: q["kn"] * d, lambda d, r, q: q["kt"], _coulomb_cap),
    "hertz_mindlin_reff": PlainLaw(
        lambda d, r, q: q["kn"] * r**0.5 * d**1.5, lambda d, r, q: q["kt"] * (r * d) ** 0.5, _coulomb_cap
    ),
}
BUILTIN |= {f"{k}_rescaled": BUILTIN[k]._replace(rescaled=True) for k in ("hertz_mindlin", "hertz_mindlin_reff")}


def users_law(functions: dict) -> PlainLaw:
    """Law from the functions of a law file, which take their arguments by name."""

    def call(name, default=None):
        if name not in functions:
            return default
        wanted = list(inspect.signature(functions[name]).parameters)

        def by_name(**values):
            return functions[name](*(values[w] for w in wanted))

        return by_name

    force, stiff, cap, reach = (call(k) for k in ("normal_force", "tangential_stiffness", "cap", "contact_range"))
    roll, roll_cap = call("rolling_stiffness"), call("rolling_cap")
    limits = cap and (lambda f, d, r, q: max(cap(normal_force=f, overlap=d, r_eff=r, **q), 0.0))
    return PlainLaw(
        lambda d, r, q: force(overlap=d, r_eff=r, **q),
        (lambda d, r, q: stiff(overlap=d, r_eff=r, **q)) if stiff else (lambda d, r, q: q["kt"]),
        limits or _coulomb_cap,
        (lambda r, q: reach(r_eff=r, **q)) if reach else PlainLaw._field_defaults["reach"],
        roll and (lambda d, r, q: roll(overlap=d, r_eff=r, **q)),
        roll_cap and (lambda f, d, r, q: max(roll_cap(normal_force=f, overlap=d, r_eff=r, **q), 0.0)),
        across_gaps=reach is not None,
    )


def cross(a, b):
    """Return a × b."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def cut(stiffness, limit, a, d, share, mode, dim, fade=1.0, held=False):
    """Slip a + share d cut at limit/stiffness, and its mode; the slip of a contact that goes on sliding turns.

    `held`: the contact slides if and only if it did.
    """
    u = a + share * d
    if limit == 0.0:
        return 0.0 * u, SLIDE
    if not (mode == SLIDE and a.any()) if held else stiffness * np.linalg.norm(u) <= limit:
        return u, STICK
    if dim == 3 and mode == SLIDE:
        radius, whole = limit / stiffness, a / fade
        kappa = 1 + whole @ d / (2 * radius**2) + (whole @ whole - radius**2) / (4 * radius**2)
        u = a + 2 * fade / (1 + fade) * max(kappa, 0.6) * d  # 0.6: `mechanics.MIN_WEIGHT`
    return u * limit / (stiffness * np.linalg.norm(u)), SLIDE


class Memory(NamedTuple):
    """Slip of a contact, rotation since it closed, their modes, and whether it has been at the Coulomb limit."""

    slip: np.ndarray
    mode: int
    roll: np.ndarray
    roll_mode: int
    reached: bool


class Twin:
    """A state in motion. `step` advances it; `load` and `turn` are the forces and torques at its positions."""

    def __init__(self, state, law, plain, dt, *, drag=0.0, spin_drag=None, rate=False, held=False, start=True):
        self.dim, self.n, self.dt, self.rate, self.time = state.cell.dim, len(state.grains.radius), dt, rate, state.time
        grains, walls, self.control, self.plain = state.grains, state.walls, state.control, plain
        still = np.zeros((len(walls.mass), 3))
        self.radius = np.append(grains.radius, 0 * walls.mass)
        self.mass, self.inertia = np.append(grains.mass, walls.mass), np.append(grains.inertia, 0 * walls.mass + 1)
        self.material, self.normal = np.append(grains.material, walls.material), walls.normal
        self.x, self.angle = np.concatenate([grains.position, walls.point]), np.concatenate([grains.angle, still])
        self.v, self.w = np.concatenate([grains.velocity, walls.velocity]), np.concatenate([grains.spin, still])
        self.h, self.periodic, self.L = state.cell.vectors.copy(), state.cell.periodic, state.cell.rate.copy()
        self.table, self.coulomb, self.model = law.table, law.coulomb, law.damping
        names = parameter_names(law)
        size = range(len(law.table))
        self.q = {(a, b): dict(zip(names, law.table[a, b].tolist(), strict=True)) for a in size for b in size}
        self.viscous = any(q["damping_n"] or q["damping_t"] for q in self.q.values())
        self.nu, self.nu_t = drag, drag if spin_drag is None else spin_drag
        free = self.control.free.copy()
        free[self.n :, 3:] = False
        free[:, 3:5] &= self.dim == 3
        free[:, 2] &= self.dim == 3
        self.free, self.own_mass = free, self.mass
        self.groups = [np.flatnonzero(self.control.group == g) for g in range(self.control.group.max() + 1)]
        self.mass = self.mass.copy()
        for members in self.groups:
            self.v[members] = np.where(
                free[members, :3], self.own_mass[members] @ self.v[members] / self.own_mass[members].sum(), 0
            )
            self.mass[members] = self.own_mass[members].sum()
        light = free[:, : self.dim].any(axis=1)
        self.inverse_mass = np.where(light, 1 / self.mass, 0.0)
        self.cell_mass = self.control.cell_mass or grains.mass.sum()
        if self.dim == 2:
            self.v[:, 2] = self.w[:, :2] = 0
        self._impose(self._factors(self.time), self.v, self.w)
        self.L = np.where(self.control.cell_free, self.L, self._imposed_gradient(self._factors(self.time)))
        self.memory, self.committed, self.before = self.read(state.contacts), self._places(state.contacts), None
        self.events, self.rate, self.held = [], False, held
        self.linear = not start  # derivatives at rest: a contact that slides stays at its limit for any velocity
        self._evaluate(self.v, self.w, self.L)  # where grains have moved since their memory was committed
        if start:
            self.committed, self.events, self.rate, self.held = None, [], rate, False
            self._evaluate(self.v, self.w, self.L)

    # what is imposed

    def _factors(self, time, until=None):
        """Values of all time profiles at a time, or their means until another; the last is 1."""
        knots, out = self.control.knots, []
        for course in self.control.course.T:
            if until is None:
                out.append(np.interp(time, knots, course))
            else:  # exact integral of a function that is linear between knots
                t = np.unique(np.concatenate([[time, until], knots[(knots > time) & (knots < until)]]))
                out.append(np.trapezoid(np.interp(t, knots, course), t) / (until - time))
        return np.array([*out, 1.0])

    def _impose(self, factors, v, w):
        rate = self.control.rate * factors[self.control.follows]
        held = ~self.control.free
        v[:], w[:] = np.where(held[:, :3], rate[:, :3], v), np.where(held[:, 3:], rate[:, 3:], w)
        if self.dim == 2:
            v[:, 2] = w[:, :2] = 0

    def _imposed_gradient(self, factors):
        return self.control.cell_rate * factors[self.control.cell_follows]

    # contacts

    @staticmethod
    def read(contacts):
        """Memory of touching contacts by (i, j, image)."""
        out = {}
        for c in range(int(contacts.count[0])):
            if contacts.mode[c] != OPEN:
                roll = contacts.rolling[c] if contacts.rolling is not None else np.zeros(7)
                key = int(contacts.i[c]), int(contacts.j[c]), *contacts.image[c].tolist()
                mode, at_cap = int(contacts.mode[c]), SLIDE if roll[6] else STICK
                out[key] = Memory(contacts.slip[c].copy(), mode, roll[:3].copy(), at_cap, bool(contacts.reached[c]))
        return out

    def _places(self, contacts):
        """Pair vector, rolled length and relative rotation at which the memory was committed."""
        out = {}
        for c in range(int(contacts.count[0])):
            if contacts.mode[c] != OPEN:
                i, j, image = int(contacts.i[c]), int(contacts.j[c]), contacts.image[c].tolist()
                turned = contacts.rolling[c, 3:6] if contacts.rolling is not None else self.angle[i] - self.angle[j]
                out[i, j, *image] = contacts.pair[c], contacts.roll[c], turned
        return out

    def _moved(self, key, r):
        """Changes of the pair vector, the rolled length and the relative rotation since the memory was committed."""
        i, j = key[:2]
        if self.committed is not None:
            roll, turned = (
                self.radius[i] * self.angle[i] + self.radius[j] * self.angle[j],
                self.angle[i] - self.angle[j],
            )
            pair, old_roll, old_turned = self.committed.get(key, (r, roll, turned))
            return r - pair, roll - old_roll, turned - old_turned
        if self.before is None:
            return np.zeros((3, 3))
        old_x, old_angle, old_h = self.before
        step = self.angle - old_angle
        way = r - self._pair(old_x, old_h, key)
        return way, self.radius[i] * step[i] + self.radius[j] * step[j], step[i] - step[j]

    def _pair(self, x, h, key):
        return x[key[0]] - x[key[1]] + np.array(key[2:]) @ h

    def _overlap(self, key, r):
        i, j = key[:2]
        if j >= self.n:
            return self.radius[i] - r @ self.normal[j - self.n]
        return self.radius[i] + self.radius[j] - np.linalg.norm(r)

    def is_tied(self, key):
        """Whether a contact at the limit is within a rigid group, so that round-off decides if it slides."""
        own, other = self.control.group[list(key[:2])]
        return own == other >= 0 and self.memory[key].reached

    def overlap(self, key):
        """Overlap of a pair at the present positions."""
        return self._overlap(key, self._pair(self.x, self.h, key))

    def _parameters(self, i, j):
        r_eff = self.radius[i] if j >= self.n else self.radius[i] * self.radius[j] / (self.radius[i] + self.radius[j])
        return self.q[self.material[i], self.material[j]], r_eff

    def _touching(self):
        """All pairs within the range of the law, by brute force."""
        wide = np.arange(-2, 3)
        images = np.stack(np.meshgrid(*(wide if p else [0] for p in self.periodic), indexing="ij"), -1).reshape(-1, 3)
        inverse, results = np.linalg.inv(self.h), []
        for i in range(self.n):
            for j in range(i, self.n):
                apart = self.x[i] - self.x[j]
                near = np.where(self.periodic, -np.round(apart @ inverse), 0).astype(int) + images
                if i == j:
                    near = np.array([m for m in near if tuple(m) > (0, 0, 0)]).reshape(-1, 3)
                q, r_eff = self._parameters(i, j)
                gap = np.linalg.norm(apart + near @ self.h, axis=1) - self.radius[i] - self.radius[j]
                results += [(i, j, *m.tolist()) for m in near[gap < self.plain.reach(r_eff, q)]]
            for j in range(self.n, len(self.x)):
                key, (q, r_eff) = (i, j, 0, 0, 0), self._parameters(i, j)
                if self._overlap(key, self.x[i] - self.x[j]) > -self.plain.reach(r_eff, q):
                    results.append(key)
        return results

    def _evaluate(self, v, w, gradient):
        """Forces at the positions; v, w and L are the velocities that dashpots use."""
        self.load, self.turn = np.zeros_like(self.x), np.zeros_like(self.x)
        self.virial, self.elastic_virial, new = np.zeros((3, 3)), np.zeros((3, 3)), {}
        for key in self._touching():
            new[key] = self._contact(key, v, w, gradient)
            old = self.memory.get(key)
            if old is None:
                self.events.append(("closed", round(self.time / self.dt), *key))
            if new[key].reached and not (old and old.reached):
                self.events.append(("limit", round(self.time / self.dt), *key))
        self.events += [("opened", round(self.time / self.dt), *k) for k in self.memory if k not in new]
        self.memory = new
        control = self.control
        self.load += control.force + self.own_mass[:, None] * control.gravity
        self.turn += control.torque
        ahead = np.append(self._factors(self.time)[:-1], 0.0)[control.leads]
        self.load += control.spring * (control.anchor + ahead - self.x)
        for members in self.groups:
            self.load[members] = self.load[members].sum(axis=0)
        volume = abs(np.linalg.det(self.h[: self.dim, : self.dim]))
        flux = np.einsum("a,ab,ac->bc", self.own_mass[: self.n], self.v[: self.n], self.v[: self.n])
        self.volume, self.flux = volume, flux

    def _contact(self, key, v, w, gradient):
        """Add the loads of one contact, and return its memory."""
        i, j, law, dt = *key[:2], self.plain, self.dt
        wall = j >= self.n
        r, own = self._pair(self.x, self.h, key), self.memory.get(key)
        normal = self.normal[j - self.n] if wall else r / np.linalg.norm(r)
        overlap, (q, r_eff) = self._overlap(key, r), self._parameters(i, j)
        curve = 0.0 if wall else 1 / np.linalg.norm(r)
        lever = self.radius[i], self.radius[j]
        way, roll, turned = self._moved(key, r)
        still = np.abs([way, roll, turned]).max() < ROUND_OFF
        # at the start of a run memory is kept bit for bit, or a contact at its limit might seem to stick
        fresh = self.before is None and (self.committed is None or (own and still and not self.held))
        # memory, carried along
        slip, mode = (own.slip, own.mode) if own else (np.zeros(3), OPEN)
        psi, psi_mode = (own.roll, own.roll_mode) if own else (np.zeros(3), STICK)
        mid = normal - 0.5 * curve * (way - normal @ way * normal)
        if self.rate:
            mid = normal
        carry = ONE - np.outer(mid, normal)
        a, d, fade, share = carry @ slip, carry @ (way + cross(mid, roll)), 1.0, 1.0
        if law.rescaled:
            if self.rate and slip.any():
                a = a * np.linalg.norm(slip) / np.linalg.norm(a)
            before = self._overlap(key, r - way)
            if own and overlap < before and overlap > 0:
                fade = (overlap / before) ** 0.5
            a = fade * a
            d = d if self.rate else 0.5 * (1 + fade) * d
        if own is None and self.before and not self.rate:
            along = normal @ way
            gained, depth = 0.5 * curve * (way @ way - along**2) - along, overlap + law.reach(r_eff, q)
            share = depth / gained if gained > depth else 1.0
        # dashpots
        if self.rate and not fresh:
            speed = way / dt + cross(normal, roll / dt)
        else:
            speed = v[i] - v[j] + gradient @ r + cross(normal, lever[0] * w[i] + lever[1] * w[j])
        factor = 0.0
        if self.viscous and not (law.across_gaps and overlap <= 0):
            light = self.inverse_mass[i] + self.inverse_mass[j]
            heavy, model = 1 / light if light else 0.0, self.model & 3
            factor = {VELOCITY: 1.0, MASS: heavy, VISCOELASTIC: heavy * (max(overlap, 0) * r_eff) ** 0.5}[model]
        vn = speed @ normal
        vt, elastic = speed - vn * normal, law.normal_force(overlap, r_eff, q)
        fn = elastic - factor * q["damping_n"] * vn
        if self.viscous and self.model & NO_TENSION:
            fn = max(fn, min(elastic, 0.0) if law.across_gaps else 0.0)
        limit, k = law.cap(fn, overlap, r_eff, q), law.tangential_stiffness(overlap, r_eff, q)
        # tangential force
        if self.viscous and self.rate:
            limit, drag = q["mu"] * abs(fn), factor * q["damping_t"]
            new, after = slip if fresh else a + d, STICK
            force = -k * new - drag * vt
            size = np.linalg.norm(force)
            if size > limit:
                if not fresh:
                    after = SLIDE
                    changed = limit / size * (new + drag * vt / k) - drag * vt / k
                force = limit / size * force if new.any() else 0 * force
                new = new if fresh else changed
        else:
            new, after = (slip, mode) if fresh else cut(
                k, limit, a, d, share, mode * (not self.rate), self.dim, fade, self.held
            )  # fmt: skip
            x = k * np.linalg.norm(new) / limit if limit else 0.0
            force = -k * new * ((1 + x - x**2 if limit else 0.0) if self.coulomb else 1.0)
            if self.viscous:
                force = force - factor * q["damping_t"] * vt
                size = np.linalg.norm(force)
                at_limit = self.linear and after == SLIDE and limit > 0
                force = force * (limit / size if at_limit or size > limit else 1.0)
        if fresh:
            after = mode or (SLIDE if limit == 0 else STICK)
        if limit == 0 and overlap <= 0:
            after = STICK  # across a gap without friction nothing slides
        # moments
        if law.rolling_stiffness:
            k_r, most = law.rolling_stiffness(overlap, r_eff, q), law.rolling_cap(fn, overlap, r_eff, q)
            if not fresh:
                psi, psi_mode = cut(k_r, most, carry @ psi, carry @ turned, share, psi_mode, self.dim, 1.0, self.held)
            self.turn[i] -= k_r * psi
            self.turn[j] += k_r * psi
        total, torque = fn * normal + force, -cross(normal, force)
        self.load[i] += total
        self.load[j] -= total
        self.turn[i] += lever[0] * torque
        self.turn[j] += lever[1] * torque
        if not wall:
            self.virial += np.outer(total, r)
            cap = law.cap(elastic, overlap, r_eff, q)
            x = k * np.linalg.norm(new) / cap if cap else 0.0
            spring = k * new * ((1 + x - x**2 if cap else 0.0) if self.coulomb else 1.0)
            self.elastic_virial += np.outer(elastic * normal - spring, r)
        reached = bool(own and own.reached) or (not fresh and after == SLIDE and limit > 0)
        return Memory(new, after, psi, psi_mode, reached)

    # motion

    def _pull(self):
        """L̇ of a free cell: M ℓ² L̇ = V (σ − wanted)."""
        stress = (self.virial + self.flux) / self.volume
        pull = self.volume * (stress - self.control.stress) / (self.cell_mass * self.volume ** (2 / self.dim))
        return np.where(self.control.cell_free, pull, 0.0)

    def step(self):
        """Kick, drift, evaluate, kick."""
        dt, free, control = self.dt, self.free, self.control
        keep, slow = 1 - self.nu * dt / 2, 1 / (1 + self.nu * dt / 2)
        keep_t, slow_t = 1 - self.nu_t * dt / 2, 1 / (1 + self.nu_t * dt / 2)
        kick, kick_t = 0.5 * dt * self.load / self.mass[:, None], 0.5 * dt * self.turn / self.inertia[:, None]
        mean, at_end = self._factors(self.time, self.time + dt), self._factors(self.time + dt)
        pull = self._pull()
        rate = np.where(control.cell_free, keep * self.L + 0.5 * dt * pull, self._imposed_gradient(mean))
        ahead = np.where(control.cell_free, slow * (rate + 0.5 * dt * pull), self._imposed_gradient(at_end))
        turn = np.linalg.solve(ONE + dt / 4 * rate, ONE - dt / 4 * rate)
        stretch = np.linalg.solve(ONE - dt / 2 * rate, ONE + dt / 2 * rate)

        def relative(v):
            return np.where(free[:, :3], v @ turn.T, v)

        self.before = self.x.copy(), self.angle.copy(), self.h.copy()
        v = relative(np.where(free[:, :3], keep * self.v + kick, self.v))
        w = np.where(free[:, 3:], keep_t * self.w + kick_t, self.w)
        self._impose(mean, v, w)
        self.x = (self.x + dt / 2 * v) @ stretch.T + dt / 2 * v
        self.angle = self.angle + dt * w
        self.h, self.time = self.h @ stretch.T, self.time + dt
        v_ahead = np.where(free[:, :3], slow * (relative(v) + kick), v)
        w_ahead = np.where(free[:, 3:], slow_t * (w + kick_t), w)
        self._impose(at_end, v_ahead, w_ahead)
        self._evaluate(v_ahead, w_ahead, ahead)
        kick, kick_t = 0.5 * dt * self.load / self.mass[:, None], 0.5 * dt * self.turn / self.inertia[:, None]
        self.v = np.where(free[:, :3], slow * (relative(v) + kick), v)
        self.w = np.where(free[:, 3:], slow_t * (w + kick_t), w)
        self._impose(at_end, self.v, self.w)
        self.flux = np.einsum("a,ab,ac->bc", self.own_mass[: self.n], self.v[: self.n], self.v[: self.n])
        self.L = np.where(control.cell_free, slow * (rate + 0.5 * dt * self._pull()), self._imposed_gradient(at_end))
