"""The (3,3) pebble game: generic rigidity of bodies in a plane that are joined by bars.

A body has three pebbles, its degrees of freedom. An independent bar takes one pebble of one of its two bodies, and a
bar is independent if four pebbles can be collected at its ends. A tight block holds 3n − 3 independent bars among its n
bodies: it is rigid. Blocks that share a body form one block, so that rigid blocks are contracted to a single body as
soon as they appear: a bar within a block is then redundant, any other bar is independent.

Source: Jacobs and Hendrickson (1997), doi:10.1006/jcph.1997.5809; Lee and Streinu (2008), pebble game algorithms and
sparse graphs, doi:10.1016/j.disc.2007.07.104.
"""

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

PEBBLES = 3


class PebbleGame:
    """Play the game for bodies 0 … `bodies` − 1 and a list `bars` of pairs of them; parallel bars are allowed.

    Afterwards, `redundant` lists the bars that are not independent, and `block` gives the rigid block of a body.
    """

    def __init__(self, bodies: int, bars: list[tuple[int, int]]):
        self.bars, self.redundant = bars, []
        self.free, self.out = [PEBBLES] * bodies, [[] for _ in range(bodies)]  # of blocks: pebbles, bars they pay for
        self.touching: list[list[int]] = [[] for _ in range(bodies)]  # of blocks: independent bars at their bodies
        self.head = [0] * len(bars)  # end of each independent bar that does not pay for it
        # union by size without shortcuts: a step towards the root knows the contraction that made it
        self.parent, self.size, self.when = list(range(bodies)), [1] * bodies, [len(bars)] * bodies
        self.events: list[list[int]] = []  # independent bars among the blocks of each contraction
        for number in range(len(bars)):
            self._insert(number)

    def block(self, body: int, before: int | None = None) -> int:
        """Rigid block of a body, at the end or before a contraction."""
        before = len(self.events) if before is None else before
        while self.when[body] < before:
            body = self.parent[body]
        return body

    def _insert(self, bar: int) -> None:
        a, b = self.bars[bar]
        u, v = self.block(a), self.block(b)
        if u == v:
            self.redundant.append(bar)
            return
        while self.free[u] + self.free[v] <= PEBBLES:
            self._collect(u, v)
        tail, self.head[bar] = (u, b) if self.free[u] else (v, a)
        self.free[tail] -= 1
        self.out[tail].append(bar)
        for end in (u, v):
            self.touching[end].append(bar)
        if self.free[u] + self.free[v] == PEBBLES:
            reached, pebble = self._search(u, v)
            if pebble is None:
                self._grow(list(reached))

    def _search(self, u: int, v: int) -> tuple[dict, int | None]:
        """Blocks reached along bars from u and v, each with the bar and the block before; and one with a pebble."""
        reached: dict = {u: None, v: None}
        queue = [u, v]
        for block in queue:
            for bar in self.out[block]:
                other = self.block(self.head[bar])
                if other not in reached:
                    reached[other] = (bar, block)
                    if self.free[other]:
                        return reached, other
                    queue.append(other)
        return reached, None

    def _collect(self, u: int, v: int) -> None:
        """Move a pebble to u or v by reversing the bars on the way to it."""
        reached, block = self._search(u, v)
        if block is None:
            raise AssertionError("no pebble is left for a bar between two rigid blocks")
        self.free[block] -= 1
        while reached[block] is not None:
            bar, before = reached[block]
            self.out[before].remove(bar)
            self.out[block].append(bar)
            a, b = self.bars[bar]
            self.head[bar] = a if self.head[bar] == b else b
            block = before
        self.free[block] += 1

    def _grow(self, blocks: list[int]) -> None:
        """Contract blocks, and then all that has become rigid with them, the smallest part first.

        Such a part pays for a bar into a block that is new to the largest one; if not, it was rigid with that before.
        """
        suspects = self._contract(blocks)
        while suspects:
            root, block = self.block(blocks[0]), self.block(suspects[-1])
            reached, pebble = ({}, 0) if root == block or self.free[block] else self._search(root, block)
            if pebble is None:
                suspects += self._contract([root, *self._smallest(reached, root)])
            else:
                suspects.pop()

    def _smallest(self, reached: dict, root: int) -> list[int]:
        """Smallest part of the blocks `reached` that pays for no bar but its own and those into the root."""
        blocks = [block for block in reached if block != root]
        number = {block: k for k, block in enumerate(blocks)}
        ends = [(number[b], self.block(self.head[bar])) for b in blocks for bar in self.out[b]]
        ends = [(k, number[other]) for k, other in ends if other != root]
        if not ends:
            return blocks[:1]
        row, column = np.array(ends).T
        graph = sparse.coo_array((np.ones(len(row)), (row, column)), shape=(len(blocks), len(blocks)))
        part = connected_components(graph, connection="strong")[1]
        leaves = np.bincount(part[row], part[row] != part[column], len(blocks))[part] > 0
        return [block for k, block in enumerate(blocks) if part[k] == part[~leaves][0]]

    def _contract(self, blocks: list[int]) -> list[int]:
        """Contract blocks to one; return blocks that pay for bars into any of them but the largest."""
        root = max(blocks, key=self.size.__getitem__)
        event = len(self.events)
        self.events.append([bar for block in blocks for bar in self.out[block]])
        outside = []
        for block in blocks:
            self.out[block] = []
            if block != root:
                self.parent[block], self.when[block] = root, event
                self.size[root] += self.size[block]
                outside += self.touching[block]
        self.touching[root] += outside
        self.free[root] = PEBBLES
        ends = [self.block(end) for bar in outside for end in self.bars[bar]]
        return [end for end in ends if end != root]

    def stressed(self) -> set[int]:
        """Bars that bear a self-stress: the redundant ones, and those without which one of them were independent.

        The latter are those of the smallest tight block that has both ends of a redundant bar. A contraction joins
        smaller blocks; if a self-stress crosses it, then all of its bars are stressed, and so are those of the smallest
        blocks that connect their ends within each of the joined blocks.
        """
        marked, joined, crossed = set(self.redundant), _Sets(len(self.parent)), {}
        tasks: list = [self.bars[bar] for bar in self.redundant]
        while tasks:
            task = tasks.pop()
            if isinstance(task, int):  # what this contraction joined is connected by stressed bars from now on
                for bar in self.events[task]:
                    joined.unite(*self.bars[bar])
            elif joined.root(task[0]) != joined.root(task[1]):
                event = self._meeting(*task)
                if event not in crossed:
                    marked.update(self.events[event])
                    tasks.append(event)
                    crossed[event] = ends = {}
                    for body in (end for bar in self.events[event] for end in self.bars[bar]):
                        tasks.append((ends.setdefault(self.block(body, event), body), body))
                tasks += [(crossed[event][self.block(body, event)], body) for body in task]
        return marked

    def _meeting(self, x: int, y: int) -> int:
        """Contraction by which two bodies came into one block."""
        event = -1
        while x != y:
            x, y = (x, y) if self.when[x] <= self.when[y] else (y, x)
            event, x = self.when[x], self.parent[x]
        return event


class _Sets:
    """Disjoint sets of numbers."""

    def __init__(self, count: int):
        self.parent = list(range(count))

    def root(self, x: int) -> int:
        while self.parent[x] != x:
            self.parent[x] = x = self.parent[self.parent[x]]
        return x

    def unite(self, x: int, y: int) -> None:
        self.parent[self.root(x)] = self.root(y)
