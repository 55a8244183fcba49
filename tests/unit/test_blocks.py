"""The choice of blocks holds what the list and the positions say, found here pair by pair in plain Python."""

import ctypes
import itertools
import re
from pathlib import Path

import numpy as np
import pytest

from stickslip import _core, laws
from stickslip.core.contacts.forces import bodies
from stickslip.core.contacts.neighbors import grid_of, rebuild_list, with_own_memory
from stickslip.core.dynamics import moving
from stickslip.core.dynamics.coefficients import make_plan
from stickslip.core.laws.compiled import FORCES, law_struct
from stickslip.core.library import core
from stickslip.core.state import OPEN, SLIDE, STICK, assembly, box, disks, empty_contacts, flat_walls, loads, spheres

LANES, IS_FIRST, IS_I, ROW, STUCK_AGAIN, LOOSE = core.LANES, 1, 2, 64, 3, 4
TYPES = {"uint32_t": "u4", "int32_t": "i4", "int64_t": "i8", "uint8_t": "?", "double": "f8"}
BUFFERS = re.findall(r"Buffer<(\w+)> ([\w, ]+);", (Path(_core.__path__[0]) / "blocks.h").read_text(encoding="utf-8"))
MEMBERS = [(name, TYPES[kind]) for kind, names in BUFFERS for name in names.split(", ")]


class Buffer(ctypes.Structure):
    """Memory and its length."""

    _fields_ = [("data", ctypes.c_void_p), ("room", ctypes.c_int64)]


class Blocks(ctypes.Structure):
    """The struct of the core, whose arrays can be read and written."""

    _fields_ = [
        ("count", ctypes.c_int64), *((name, Buffer) for name, _ in MEMBERS),
        *((name, ctypes.c_int64) for name in ("tiles", "turns", "own", "at_own")),
    ]  # fmt: skip

    def arrays(self):
        """All arrays, which may be longer than needed."""
        for name, kind in MEMBERS:
            buffer, dtype = getattr(self, name), np.dtype(kind)
            memory = (ctypes.c_char * (buffer.room * dtype.itemsize)).from_address(buffer.data or 0)
            yield name, np.frombuffer(memory, dtype)


@pytest.fixture
def chosen():
    """Blocks without pairs, as an address, freed afterwards."""
    address = core.new_blocks()
    yield address
    core.free_blocks(address)


CASES = {
    "spheres": {},
    "threads": {"threads": 3, "materials": 2},
    "disks": {"dim": 2, "periodic": (True, False, False), "threads": 2, "frame": True},
    "walls": {"walls": True, "materials": 3, "threads": 2, "last": 9},
    "sheared": {"periodic": (True, True, True), "tilt": 0.4, "last": 5},
    "one tile": {"periodic": (True, True, True), "tile": 500},  # whose blocks are full
}


def law_of(materials):
    """A law whose contacts have all memory that there is, and need radius and mass."""
    law = laws.walton_braun(k_unload=2.0, damping="viscoelastic", damping_n=0.1)
    law = laws.with_twisting(laws.with_rolling(law, k_roll=0.1, mu_roll=0.1), k_twist=0.1, mu_twist=0.1)
    return law._replace(table=np.tile(law.table, (materials, materials, 1)))


class Assembly:
    """Random overlapping grains with a list whose memory is random, and the limits of a choice."""

    def __init__(
        self, dim=3, walls=False, periodic=(False,) * 3, tilt=0.0, materials=1, threads=1, last=0, frame=False
    ):
        self.rng = rng = np.random.default_rng(dim + materials + threads + last)
        n, side = 160, 11.0 if dim == 3 else 27.0
        x = rng.random((n, 3)) * side * (1, 1, dim == 3)
        make = spheres if dim == 3 else disks
        grains = make(x, rng.uniform(0.8, 1.2, n), mass=rng.uniform(1, 2, n), material=rng.integers(materials, size=n))
        sides = flat_walls([[0, 0, 0], [side, 0, 0]], [[1, 0, 0], [-1, 0, 0]], material=[0, materials - 1])
        vectors = side * np.array([[1, 0, 0], [tilt, 1, 0], [0, 0, 1.0]])
        control = loads(n, 2 * walls)
        control.spring[rng.permutation(n)[:last], 0] = 1.0
        self.state = state = assembly(grains, sides if walls else None, box(vectors, periodic, dim), control)
        self.here = bodies(state)
        old = empty_contacts(state.n_bodies, 0, 0.5, bare=True, keyed=False)
        self.list = rebuild_list(self.here.position, self.here.radius, self.here.normal, grid_of(state.cell), old)
        self.law = law_of(materials)
        self.list = with_own_memory(self.list, self.law)
        self.fill_memory(self.list.mode, self.list.reached, self.list.slip)
        self.list.rolling[:] = rng.normal(size=self.list.rolling.shape)
        plan = make_plan(state, 0.0, 0.0, 1.0)
        self.moving = moving.make_moving_bodies(state, plan, self.here, False, frame, False, threads)
        self.room, self.materials = rng.uniform(0, 0.1, state.n_bodies), materials
        self.struct = core.fill("Law", law_struct(self.law, members=FORCES))
        self.across = np.eye(3) if frame else state.cell.vectors
        self.place = np.argsort(self.moving.order)

    def fill_memory(self, mode, reached, slip):
        """Write random modes and slips."""
        mode[:] = self.rng.choice([OPEN, OPEN, STICK, SLIDE], mode.shape)
        reached[:], slip[:] = self.rng.random(mode.shape) < 0.5, self.rng.normal(size=slip.shape)

    def choose(self, address):
        """Blocks, their arrays by name, and the rows of the list that they hold with block and lane."""
        known, cell = self.here, self.state.cell
        assert core.choose_blocks(
            address, self.struct, self.list, self.moving, known.inverse_mass, known.material, known.normal,
            len(known.normal), cell.vectors, self.across, self.room, self.list.gap,
        )  # fmt: skip
        blocks = Blocks.from_address(address)
        b = dict(blocks.arrays())
        slots = [s for s in range(LANES * blocks.count) if b["row"][s] >= 0]
        return blocks, b, {int(b["row"][s]): divmod(s, LANES) for s in slots}, slots

    def reach(self, c):
        """Whether pair c may touch within the limits."""
        i, j = self.list.i[c], self.list.j[c]
        g, h = self.place[i], self.place[j]
        body, n = self.moving.body, len(self.state.grains.radius)
        r = body[g, :3] - body[h, :3] + self.list.image[c] @ self.state.cell.vectors
        distance = r @ self.here.normal[j - n] if j >= n else np.linalg.norm(r)
        return distance < self.here.radius[i] + self.here.radius[j] + self.room[g] + self.room[h]

    def move(self):
        """Move all grains within the limits."""
        x = self.moving.body[: len(self.state.grains.radius), : self.state.cell.dim]
        x += self.rng.uniform(-0.05, 0.05, x.shape)


@pytest.fixture(params=CASES)
def grains(request, monkeypatch):
    """An assembly of the cases, in small tiles by default."""
    case = {"tile": 20} | CASES[request.param]
    monkeypatch.setattr(moving, "TILE_SIZE", case.pop("tile"))
    return Assembly(**case)


def test_each_pair_that_may_touch_is_in_one_lane_with_its_memory(grains, chosen):
    for _ in range(2):
        blocks, b, lanes, slots = grains.choose(chosen)
        held = grains.list
        near = [c for c in range(held.count[0]) if held.mode[c] != OPEN or grains.reach(c)]
        assert sorted(lanes) == near
        assert len(slots) == len(near) > 100
        assert len(near) < held.count[0]  # the choice leaves some out
        memory = {(STICK, True): STUCK_AGAIN, (SLIDE, False): LOOSE}
        slip = b["slip"][: 3 * LANES * blocks.count].reshape(-1, 3, LANES)
        for c, (at, lane) in lanes.items():
            s, i, j = LANES * at + lane, held.i[c], held.j[c]
            assert (b["i"][s], b["j"][s]) == (grains.place[i], grains.place[j])
            assert b["mode"][s] == memory.get((held.mode[c], bool(held.reached[c])), held.mode[c])
            assert np.array_equal(slip[at, :, lane], held.slip[c])
            wall, r, m = b["wall"][at], grains.here.radius[[i, j]], grains.here.inverse_mass[[i, j]].sum()
            assert b["size"][s] == pytest.approx(r[0] if wall else 1 / (1 / r).sum(), rel=1e-15)
            assert b["mass"][s] == pytest.approx(1 / m, rel=1e-15)
            vector = b["vector"][b["at"][at] :][: 3 * LANES].reshape(3, LANES)[:, lane] if b["at"][at] >= 0 else 0.0
            normal = grains.here.normal[j - len(grains.state.grains.radius)] if wall else held.image[c] @ grains.across
            assert np.array_equal(vector + np.zeros(3), normal)
        grains.move()


def test_blocks_hold_one_pair_of_materials_within_their_tiles(grains, chosen):
    blocks, b, _, slots = grains.choose(chosen)
    tile, last, material = grains.moving.tile, blocks.tiles, grains.here.material[grains.moving.order]
    share = grains.moving.share
    bound = [*b["cross"][: last + 2], *b["inner"][1 : last + 2]]
    assert bound[-1] == blocks.count
    for s in slots:
        at, ends = s // LANES, [b["i"][s], b["j"][s]]
        if grains.materials > 1:
            assert list(b["material"][2 * at : 2 * at + 2]) == list(material[ends])
        assert b["wall"][at] == (grains.moving.order[ends[1]] >= len(grains.state.grains.radius))
        sooner, later = sorted(np.minimum(np.searchsorted(tile, ends, "right") - 1, last))
        apart = later < last and np.searchsorted(share, sooner, "right") != np.searchsorted(share, later, "right")
        group = sooner + last + 1 if sooner == later < last else last if apart else sooner
        assert bound[group] <= at < bound[group + 1]


def test_padding_pairs_a_body_with_itself_out_of_reach(grains, chosen):
    blocks, b, _, slots = grains.choose(chosen)
    padding = sorted({*range(LANES * blocks.count)} - {*slots})
    assert padding
    for s in padding:
        at, lane = divmod(s, LANES)
        body = grains.moving.body[b["i"][s]]
        assert b["i"][s] == b["j"][s]
        assert b["mode"][s] == OPEN
        assert b["at"][at] >= 0
        vector = b["vector"][b["at"][at] + lane :][: 3 * LANES : LANES]
        assert body[core.RADIUS] == 0 if b["wall"][at] else vector[0] > 2 * body[core.RADIUS] + 0.2


def test_each_body_sums_its_loads_in_the_order_of_partners(grains, chosen):
    _, b, lanes, _ = grains.choose(chosen)
    own: dict = {a: [] for a in range(grains.state.n_bodies)}
    for c, (at, lane) in lanes.items():
        i, j, load = grains.list.i[c], grains.list.j[c], ROW * int(b["place"][at] + lane)
        own[j].append((i, c, load))
        own[i].append((j, c, load + IS_I))
    for a, entries in own.items():
        g = grains.place[a]
        codes = b["code"][b["start"][g] : b["start"][g + 1]]
        if entries:
            assert [codes[0] - IS_FIRST, *codes[1:]] == [code for _, _, code in sorted(entries)]
        else:
            assert len(codes) == 1
            assert codes[0] % ROW == IS_FIRST
            assert not b["load"][codes[0] // ROW * 8 :][:8].any()
    assert b["load"].ctypes.data % 64 == 0


def test_no_two_blocks_that_are_needed_at_once_share_rows_of_loads(grains, chosen):
    blocks, b, _, slots = grains.choose(chosen)
    last, share, cross, inner = blocks.tiles, grains.moving.share, b["cross"], b["inner"]
    needed = {at: [last, 0] for at in range(blocks.count)}  # first and last tile whose bodies sum the loads
    for s in slots:
        tiles = np.minimum(np.searchsorted(grains.moving.tile, [b["i"][s], b["j"][s]], "right") - 1, last)
        needed[s // LANES] = [min(*tiles, needed[s // LANES][0]), max(*tiles, needed[s // LANES][1])]
    needed |= {at: [0, last] for at in range(cross[last], cross[last + 1])}
    worker = {at: k for k in range(len(share) - 1) for part in (cross, inner)
              for at in range(part[share[k]], part[share[k + 1]])}  # fmt: skip
    for first, second in itertools.combinations(range(blocks.count), 2):
        apart = needed[first][1] < needed[second][0] or needed[second][1] < needed[first][0]
        if not apart or worker.get(first) != worker.get(second):
            assert abs(b["place"][first] - b["place"][second]) >= LANES
    assert (b["place"][: blocks.count].max() + LANES) * 8 < len(b["load"])


def test_the_memory_of_blocks_is_written_back_before_they_are_chosen_again(grains, chosen):
    modes = [OPEN, STICK, SLIDE, STUCK_AGAIN, LOOSE]
    plain = {STUCK_AGAIN: STICK, LOOSE: SLIDE}
    for again in (False, True):
        blocks, b, lanes, slots = grains.choose(chosen)
        slip = b["slip"][: 3 * LANES * blocks.count].reshape(-1, 3, LANES)
        slip[:] = grains.rng.normal(size=slip.shape)
        turn, own = b["turn"][: 6 * LANES * blocks.count].reshape(-1, 6, LANES), b["memory"]
        for c, (at, lane) in lanes.items():  # as the list had it; contacts that are open have none
            closed, row = grains.list.mode[c] != OPEN, grains.list.rolling[c]
            np.testing.assert_array_equal(turn[at, :, lane], row[[0, 1, 2, 6, 7, 8]] if closed else np.zeros(6))
            assert own[LANES * at + lane] == (row[9] if closed else 0.0)
        b["mode"][slots] = grains.rng.choice(modes, len(slots))
        turn[:], own[:] = grains.rng.normal(size=turn.shape), grains.rng.normal(size=own.shape)
        wanted = {
            c: (
                b["mode"][LANES * at + lane],
                slip[at, :, lane].copy(),
                turn[at, :, lane].copy(),
                own[LANES * at + lane],
            )
            for c, (at, lane) in lanes.items()
        }
        grains.choose(chosen) if again else core.commit_blocks(chosen, grains.list)
        for c, (mode, moved, turned, further) in wanted.items():
            np.testing.assert_array_equal(grains.list.rolling[c, [0, 1, 2, 6, 7, 8]], turned)
            assert mode == OPEN or grains.list.rolling[c, 9] == further
            assert grains.list.mode[c] == plain.get(mode, mode)
            assert grains.list.reached[c] == (mode in (SLIDE, STUCK_AGAIN))
            assert np.array_equal(grains.list.slip[c], moved)
    core.clear_blocks(chosen)
    assert bytes(Blocks.from_address(chosen)) == bytes(ctypes.sizeof(Blocks))
