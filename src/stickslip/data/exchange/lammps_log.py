"""Commands and runs in the text of a log or an input script of LAMMPS, apart from what LAMMPS reports between them."""

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from ...known import UNKNOWN, group_of

LOG = re.compile(r"\ALAMMPS \(|\A[^\n]*OMP_NUM_THREADS")
RAN = re.compile(r"(?m)^(Per MPI rank memory allocation|Loop time of \S+ on) ")
HEAD = re.compile(r"LAMMPS \(\d+ \w+ (\d{4})")
BEGINS = re.compile(r"Per MPI rank memory allocation |Memory usage per processor ")
LOOP = re.compile(r"Loop time of \S+ on \d+ procs(?: \([^)]*\))? for (\d+) steps with (\d+) atoms")
VERSION, LATTICE, BONDS, MEMBERS = "(version)", "(spacing)", "(bonds)", "(members)"
NAMED = re.compile(r"[a-z]\w*(/\w+)*(\s|$)")  # how a command begins that is none of those known
TALKING = ("info", "package", "run", "minimize", "rerun")  # commands after which any words may come
QUOTES, MOST_QUOTED = '"""', 1000  # marks of a text of several lines, and lines that it may have
REPORTS = {  # what LAMMPS reports, in the place of commands
    VERSION: HEAD, LATTICE: re.compile(r"Lattice spacing in x,y,z = (.*)"),
    BONDS: re.compile(r"\s+([1-9]\d* (?:bonds|angles|dihedrals|impropers))\s*$"),
    MEMBERS: re.compile(r"(\d+ atoms in group \S+)\s*$"),
}  # fmt: skip
ENDLESS = float("inf")


class Command(NamedTuple):
    """A command, or a line of a log that may be one."""

    source: str  # name of the file
    number: int  # of its line
    line: str  # without comments
    step: int | None = None  # time step; None if it is not known

    @property
    def words(self) -> list[str]:
        """Words of the line."""
        return self.line.split()


class Block(NamedTuple):
    """A run in time, or a minimization."""

    start: int | None  # time step; None if it is not known
    end: float  # infinite if it was interrupted
    atoms: int | None = None


def recognize_log(text: str) -> bool:
    """Return True for a log, in which LAMMPS repeats its commands with the values of variables.

    One that a command `log` began has no line with the version.
    """
    return bool(LOG.search(text[:200]) or RAN.search(text))


def read_events(texts: Sequence[tuple[str, str]], *, log: bool) -> Iterator[Command | Block]:
    """Commands and runs of files in the order in which they were written; each file has a name and a text."""
    step: int | None = 0
    last: Command | None = None
    for source, text in texts:
        numbers, lines = zip(*_logical_lines(text, log=log), strict=True) if text else ((), ())
        k = 0
        while k < len(lines):
            number, line = numbers[k], lines[k]
            k += 1
            if log and (BEGINS.match(line) or LOOP.match(line)):
                block, k = _read_block(lines, k - 1, step, last.words if last else [])
                yield block
                last = None
                step = None if block.end == ENDLESS or block.start is None else int(block.end)
                continue
            for command in _commands(source, number, line, step, log=log, after=last):
                yield command
                last, step = command, _step_after(command.words, step)
                k += _answer_lines(line, lines[k:][:MOST_QUOTED]) if log and command.words[0] == "print" else 0


def _logical_lines(text: str, *, log: bool) -> Iterator[tuple[int, str]]:
    """Number and content of each line, with those that continue it: within triple quotes, or after & in a script."""
    lines, k = text.split("\n"), 0
    while k < len(lines):
        first, whole, k = k, lines[k], k + 1
        if whole.count(QUOTES) % 2:
            near = range(k, min(k + MOST_QUOTED, len(lines)))
            end = next((j for j in near if lines[j].count(QUOTES) % 2), first)
            whole, k = "\n".join(lines[first : end + 1]), end + 1
        while not log and k < len(lines) and re.search(r"&[ \t]*$", whole):
            whole, k = re.sub(r"&[ \t]*$", " ", whole) + lines[k], k + 1
        yield first + 1, whole


def _commands(
    source: str, number: int, line: str, step: int | None, *, log: bool, after: Command | None
) -> Iterator[Command]:
    """The command in a line, or what LAMMPS reports in one of a log."""
    for name, form in REPORTS.items() if log else ():
        if found := form.match(line):
            yield Command(source, number, f"{name} {found[1]}", step)
            return
    bare = line if QUOTES in line else re.sub(r"""("[^"]*"|'[^']*')|#.*""", lambda m: m[1] or "", line)
    words = bare.split()
    if not words or (log and any(word.endswith(":") for word in words[:2])):
        return
    if log and group_of("command", words[0]) == UNKNOWN:
        told = after.line if after and after.words[0] == "variable" else ""
        talk = re.search(r'".*\$', told) or (after and after.words[0] in TALKING)
        if talk or group_of("line of a log", words[0]) != UNKNOWN or not NAMED.match(bare):
            return
    yield Command(source, number, bare.strip(), step)


def _answer_lines(line: str, after: Sequence[str]) -> int:
    """Number of the lines after a command `print` that are its text, in which variables may have got their values."""
    found = re.search(r'print\s+(?:"""(.*?)"""|"([^"]*)"|\'([^\']*)\'|(\S+))', line, re.DOTALL)
    text = next((part for part in found.groups() if part is not None), "") if found else ""
    wanted = text.split("\n")
    got = [line.strip() for line in after[: len(wanted)]]
    if "$" in text and not re.search(r"\b(screen|universe)\s+no\b", line):
        return len(got)
    return len(got) if got == [line.strip() for line in wanted] else 0


def _step_after(words: list[str], step: int | None) -> int | None:
    """Time step after a command that sets it; None if it is not known."""
    if words[0] in (VERSION, "clear"):
        return 0
    if words[0] == "reset_timestep":
        return int(words[1]) if words[1:] and words[1].isdecimal() else None
    return None if words[0] in ("read_restart", "read_dump", "rerun") else step


def _read_block(lines: Sequence[str], k: int, step: int | None, last: list[str]) -> tuple[Block, int]:
    """A run from its first line, with the steps of its table if it has any, and the number of the line after it."""
    seen: list[int] = []
    column, width = None, 0
    while k < len(lines) and not HEAD.match(lines[k]):
        line, k = lines[k], k + 1
        words = line.split()
        if done := LOOP.match(line):
            start = seen[0] if seen else step
            end = ENDLESS if start is None else start + int(done[1])
            return Block(start, end, int(done[2])), k
        if "Step" in words:
            rich = re.match(r"-+ Step\s+(\d+) ", line)
            seen += [int(rich[1])] if rich else []
            column, width = (None if rich else words.index("Step")), len(words)
        elif column is not None and len(words) == width and words[column].isdecimal():
            seen.append(int(words[column]))
    start = seen[0] if seen else step
    count = int(last[1]) if last[:1] == ["run"] and last[1:] and last[1].isdecimal() else None
    stop = ENDLESS if start is None or count is None else count if "upto" in last else start + count
    return Block(start, stop), k
