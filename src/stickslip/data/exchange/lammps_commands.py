"""Commands of a LAMMPS run, from its log or input script, and the settings in force when its grains were written.

A log consists of commands, runs, and reports between them.
"""

import re
from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from itertools import pairwise, takewhile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...known import BONDED, FORCE_STYLES, HARMLESS, UNKNOWN, USED, find_row, group_of, plain_style
from .columns import read_content, read_lines

LOG = re.compile(r"\ALAMMPS \(|\A[^\n]*OMP_NUM_THREADS")
RAN = re.compile(r"(?m)^(Per MPI rank memory allocation|Loop time of \S+ on) ")
HEAD = re.compile(r"LAMMPS \(\d+ \w+ (\d{4})")
BEGINS = re.compile(r"Per MPI rank memory allocation |Memory usage per processor ")
LOOP = re.compile(r"Loop time of \S+ on \d+ procs(?: \([^)]*\))? for (\d+) steps with (\d+) atoms")
VERSION, LATTICE, BONDS, MEMBERS = "(version)", "(spacing)", "(bonds)", "(members)"
NAMED = re.compile(r"[a-z]\w*(/\w+)*(\s|$)")  # beginning of an unknown command
TALKING = ("info", "package", "run", "minimize", "rerun")  # commands with arbitrary arguments
QUOTES, MOST_QUOTED = '"""', 1000  # quotes around a text of several lines, and the largest number of these lines
REPORTS = {  # reports that are treated as commands
    VERSION: HEAD, LATTICE: re.compile(r"Lattice spacing in x,y,z = (.*)"),
    BONDS: re.compile(r"\s+([1-9]\d* (?:bonds|angles|dihedrals|impropers))\s*$"),
    MEMBERS: re.compile(r"(\d+ atoms in group \S+)\s*$"),
}  # fmt: skip
ENDLESS = float("inf")


class Command(NamedTuple):
    """A command, or a line of a log that may be one."""

    source: str  # name of the file
    number: int  # line number
    line: str  # without comments
    step: int | None = None  # time step; None if unknown

    @property
    def words(self) -> list[str]:
        """Words of the line."""
        return self.line.split()


class Block(NamedTuple):
    """A run in time, or a minimization."""

    start: int | None  # time step; None if unknown
    end: float  # infinite if it was interrupted
    atoms: int | None = None


def recognize_log(text: str) -> bool:
    """Return True for a log, in which LAMMPS repeats its commands with the values of variables.

    A log started by a command `log` has no line with the version.
    """
    return bool(LOG.search(text[:200]) or RAN.search(text))


def read_events(texts: Sequence[tuple[str, str]], *, log: bool) -> Iterator[Command | Block]:
    """Commands and runs of files in the order in which they were written; `texts` are names and texts of the files."""
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
                last, words = command, command.words
                if words[0] in (VERSION, "clear"):
                    step = 0
                elif words[0] == "reset_timestep":
                    step = int(words[1]) if words[1:] and words[1].isdecimal() else None
                elif words[0] in ("read_restart", "read_dump", "rerun"):
                    step = None
                k += _answer_lines(line, lines[k:][:MOST_QUOTED]) if log and words[0] == "print" else 0


def _logical_lines(text: str, *, log: bool) -> Iterator[tuple[int, str]]:
    """Number and text of each line, joined with its continuation: within triple quotes, or after & in a script."""
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
    """The command in a line, or the report in a line of a log."""
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
    """Number of lines that a command `print` wrote; variables in the command may already have been replaced."""
    found = re.search(r'print\s+(?:"""(.*?)"""|"([^"]*)"|\'([^\']*)\'|(\S+))', line, re.DOTALL)
    text = next((part for part in found.groups() if part is not None), "") if found else ""
    wanted = text.split("\n")
    got = [line.strip() for line in after[: len(wanted)]]
    if "$" in text and not re.search(r"\b(screen|universe)\s+no\b", line):
        return len(got)
    return len(got) if got == [line.strip() for line in wanted] else 0


def _read_block(lines: Sequence[str], k: int, step: int | None, last: list[str]) -> tuple[Block, int]:
    """Run that begins at a line, with the time steps of its table if there is one, and the number of the next line."""
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


LONGEST_LINE = 4096  # largest number of characters that the values of variables add to a line
UNRESOLVED = re.compile(r"\$\{?[({\w]")
QUOTED = re.compile(r"\"\"\".*?\"\"\"|\"[^\"]*\"|'[^']*'", re.DOTALL)  # texts in which LAMMPS replaces no variables
# fixes that change the number of grains
INSERTING = ("pour", "deposit", "evaporate", "gcmc", "append/atoms", "bond/react")
RENUMBERING = ("delete_atoms", "replicate", "read_dump")  # commands that change the number of grains
COUNTING = {*RENUMBERING, "create_atoms"}
RELABELING = ("reset_atoms", "reset_ids", "reset_atom_ids")  # commands that change ids
COMBINED = ("union", "subtract", "intersect")  # styles of groups that are composed of other groups
OPENING = ("include", "if", "jump", "python")  # commands that execute commands which are not in the script
ABOUT_BONDS = (  # commands that change bonds, or change lengths that may be rest lengths
    "bond_style", "bond_coeff", "special_bonds", "create_bonds", "delete_bonds", "labelmap", "read_data",
    "read_restart", "run", "minimize", "rerun", "displace_atoms", "change_box", "read_dump", "replicate", "set",
)  # fmt: skip
WRITING = ("write_restart", "write_data", "write_dump")
NODES = {"sc": 1, "bcc": 2, "fcc": 4, "diamond": 8, "sq": 1, "sq2": 2}  # lattice points per cell, a cube or square
BEGINNING = ("read_data", "read_restart")  # commands by which a run reads grains from a file
FILING = (*WRITING, *BEGINNING, "restart", "dump")  # commands that name files of grains


class Region(NamedTuple):
    """A region, and the unit of its lengths if they are in lattice units."""

    words: list[str]  # style and arguments
    spacing: list[str] | None = None  # spacing of the lattice at this command, empty if unknown; None without a lattice


class Dump(NamedTuple):
    """A dump of grains, with the changes made by `dump_modify`."""

    command: str  # command without the name of the file
    file: str
    columns: list[str]
    selection: str  # the command that leaves grains out; empty if there is none
    names: dict[str, str]  # names of columns in LAMMPS by their names from `colname`

    def modified(self, command: str, words: Sequence[str]) -> "Dump":
        """The dump after one more command, given as its words."""
        selection, names = self.selection, self.names
        for k, word in enumerate(words):
            if word == "thresh":
                limit = " ".join([command, *words[k : k + 4]])
                selection = _selection(self.command) if words[k + 1 : k + 2] == ["none"] else limit
            elif word == "colname" and len(words) > k + 2 and (own := self._column(words[k + 1])):
                names = {new: name for new, name in names.items() if name != own} | {words[k + 2]: own}
        return self._replace(selection=selection, names=names)

    def _column(self, word: str) -> str:
        """Name of a column in LAMMPS from a name or number; empty if unknown."""
        if not re.fullmatch(r"-?[1-9]\d*", word):
            return word
        at = int(word) - (int(word) > 0)
        known = -len(self.columns) <= at < len(self.columns) and not any("*" in name for name in self.columns)
        return self.columns[at] if known else ""


def _selection(command: str) -> str:
    """Return a command that writes grains if it leaves grains out, otherwise an empty text."""
    return "" if command.split()[-1] == "all" else command


class Run(NamedTuple):
    """Settings in force when the grains were written."""

    source: str  # name of the log or script
    pair_style: list[str]  # style and arguments; empty if there is none
    pair_coeff: list[list[str]]
    fixes: dict[str, list[str]]  # group, style and the words that follow, by id
    groups: dict[str, list[list[str]]]  # words of each command `group`, by name
    regions: dict[str, Region]
    settings: dict[str, list[str]]  # words of units, boundary, atom_style, newton
    unknown: list[str]  # commands with an outcome, or with variables, that cannot be known here
    acts: dict[str, str]  # latest sentence, by key, on unread commands that may exert or change forces
    places: dict[str, str]  # file and line of each fix, by id, and of the pair style
    met: dict[str, set[str]]  # first words of commands, by their group
    labels: dict[str, int]  # types of atoms by their labels
    dumps: dict[str, Dump]  # dumps by name
    bonds: list[list[str]]  # words of commands that concern bonds, after their positions
    year: int = 0  # year of the version of LAMMPS; 0: unknown
    sources: tuple[str, ...] = ()  # names of the files, in their order
    blocks: tuple[Block, ...] = ()  # runs in time; none if the log or script does not state their steps
    atoms: int | None = None  # number of grains when they were written; None if unknown
    place: int = 0  # position in the log or script at which the grains were written

    def numbers(self, words: Sequence[str]) -> list[str]:
        """Words in which labels of types are replaced by the numbers of these types."""
        return [str(self.labels.get(word, word)) for word in words]

    def steps(self) -> tuple[float, float] | None:
        """First and last time step; None if unknown."""
        blocks = [block for block in self.blocks if block.start is not None]
        if not blocks or len(blocks) < len(self.blocks):
            return None
        return min(block.start for block in blocks), max(block.end for block in blocks)

    def goes_back(self) -> bool:
        """Return True if a run had earlier time steps than a previous one, as after `reset_timestep`."""
        starts = [block.start for block in self.blocks if block.start is not None]
        return any(later < start for start, later in pairwise(starts))

    def has_step(self, step: int) -> bool:
        """Return True if a time step may be one of the run."""
        return step < 0 or self.steps() is None or any(block.start <= step <= block.end for block in self.blocks)


def recognize_script(text: str) -> bool:
    """Return True for an input script of grains."""
    return bool(re.search(r"(?m)^\s*(pair_style|atom_style|read_data|read_restart)\s", text))


def read_commands(path: Path, until: str = "", before: Sequence[Path] = (), step: int = -1) -> Run:
    """Replay the commands of a log or an input script up to the time when the grains were written.

    Parameters
    ----------
    until : name of the file of the grains; commands after the last one that wrote it are ignored
    before : earlier logs of the same run
    step : time step of the grains; -1 if unknown
    """
    texts = [(other.name, read_lines_of(other)) for other in (*before, path)]
    log = recognize_log(texts[0][1])
    events = list(read_events(texts, log=log))
    blocks = tuple(event for event in events if isinstance(event, Block)) if log else ()
    run = _empty(path.name)
    values: dict[str, str] = {}
    end = _end(events, until, step)
    for event in events[:end]:
        if isinstance(event, Command):
            run = _replay(run, event, values, log=log)
    said = {event.words[0] for event in events if isinstance(event, Command)}
    if blocks and not said & {"run", "minimize", "rerun"}:
        run.acts["echo"] = f"{path.name} does not repeat its commands (`echo none` or `echo screen`)"
    # the number of grains is unknown if it may have changed during a run or after it
    begin = max((k for k, event in enumerate(events) if _writes_dump(event, until)), default=0)
    counts = {
        event.atoms for event in events[begin:]
        if isinstance(event, Block) and event.start is not None and event.start <= step <= event.end
    }  # fmt: skip
    since = takewhile(lambda event: isinstance(event, Command), reversed(events[:end]))
    after = end == len(events) or isinstance(events[end], Command)  # after the last run, not within one
    changing = any(style in INSERTING for _, style, *_ in run.fixes.values())
    changing = changing or (after and any(command.words[0] in COUNTING for command in since))
    atoms = counts.pop() if len(counts) == 1 and not changing else None
    return run._replace(blocks=blocks, sources=tuple(name for name, _ in texts), atoms=atoms, place=end)


def _empty(source: str, year: int = 0) -> Run:
    met: dict[str, set[str]] = {USED: set(), HARMLESS: set(), UNKNOWN: set()}
    return Run(source, [], [], {}, {}, {}, {}, [], {}, {}, met, {}, {}, [], year)


def _end(events: list[Command | Block], until: str, step: int) -> int:
    """Number of events before a state: up to the last command that wrote it to `until`, or to the run that reached it.

    Only commands before a run affect files written during it. If several runs reached a time step, as after
    `reset_timestep`, the last one in which a command wrote the file counts.
    """
    writes = [
        k for k, event in enumerate(events)
        if isinstance(event, Command) and until and event.words[0] in WRITING
        and any(means(word, until) for word in event.words[1:])
        and (step < 0 or event.step in (None, step))
    ]  # fmt: skip
    if writes:
        return writes[-1] + 1
    runs = [k for k, event in enumerate(events) if isinstance(event, Block) and event.start is not None]
    if not runs:  # the state was written before the command `undump` that ended its dump
        closed, name = 0, ""
        for k, event in enumerate(events):
            if _writes_dump(event, until):
                closed, name = 0, event.words[1]
            elif isinstance(event, Command) and event.words[:2] == ["undump", name]:
                closed = k
        if closed:
            return closed
    open_in = _open_in(events, until)
    runs = [k for k in runs if k in open_in] or runs
    reached = [k for k in runs if events[k].start < step <= events[k].end or events[k].start == events[k].end == step]
    reached = reached or [k for k in runs if events[k].start <= step <= events[k].end]
    if step < 0 or not reached:
        return len(events)
    later = any(isinstance(event, Block) for event in events[reached[-1] + 1 :])
    return reached[-1] if later or events[reached[-1]].end != step else len(events)


def _open_in(events: list[Command | Block], name: str) -> set[int]:
    """Positions of the runs during which a command `dump` or `restart` was writing a file."""
    ids, series, places = set(), False, set()
    for k, event in enumerate(events):
        if isinstance(event, Block):
            places |= {k} if series or ids else set()
        elif _writes_dump(event, name):
            ids.add(event.words[1])
        elif event.words[0] == "undump":
            ids -= {*event.words[1:2]}
        elif event.words[0] == "restart":
            series = any(means(word, name, series=True) for word in event.words[2:])
    return places


def means(word: str, name: str, *, series: bool = False) -> bool:
    """Return True if a word of a command matches the name of a file; * and % stand for time steps and processes.

    In a series, the name continues with a time step.
    """
    word = Path(word.strip("\"'")).name.replace("%", "*")
    return bool(word.strip("*.")) and (fnmatchcase(name, word) or (series and name.startswith(f"{word}.")))


def _writes_dump(event: Command | Block, name: str) -> bool:
    """Return True for the command `dump` that writes the named file."""
    words = event.words if isinstance(event, Command) else [""]
    return words[0] == "dump" and len(words) > 5 and bool(name) and fnmatchcase(name, Path(words[5]).name)


def read_lines_of(path: Path) -> str:
    """Text of a log or script, whose last line may be incomplete."""
    try:
        return read_lines(path)
    except ValueError:
        return read_content(path).decode("utf-8", errors="replace").replace("\r\n", "\n")


def _replay(run: Run, command: Command, values: dict[str, str], *, log: bool) -> Run:
    """Run with the settings after one more command; `values` are those of variables, which logs already contain."""
    words = command.words
    if words[0] == "variable" and len(words) > 3:
        values |= _value(words, values)
    line = command.line if log else _substitute(command.line, values)
    bare = QUOTED.sub(" ", line) if log else line
    if log and words[0] == "echo" and words[1:2] in (["none"], ["screen"]):
        run.acts["echo"] = f"{command.source} does not repeat the commands that follow `{' '.join(words)}`"
    if log and words[:2] == ["log", "none"]:
        run.acts["echo"] = f"{command.source} does not contain the commands that follow `log none`"
    if not log and words[0] in OPENING and words[1:2] != ["SELF"]:
        run.unknown.append(" ".join(words))
    if UNRESOLVED.search(bare):
        if not log and words[0] in ("fix", "pair_style", "pair_coeff"):
            run.unknown.append(" ".join(words))
        if words[0] in ABOUT_BONDS:
            run.bonds.append([f"{command.source}, line {command.number}", *words])
        return run
    return _apply(run, [word.strip("\"'") for word in line.split()], f"{command.source}, line {command.number}")


def numbers_in(words: Sequence[str]) -> list[float]:
    """Numbers among words."""
    return [float(word) for word in words if re.fullmatch(r"[-+]?\d*\.?\d+\.?([eE][-+]?\d+)?", word)]


def _value(tokens: Sequence[str], values: dict[str, str]) -> dict[str, str]:
    """Value of a variable by its name, if it is known without running LAMMPS."""
    name, style, first = tokens[1], tokens[2], _substitute(tokens[3], values).strip('"')
    if style in ("index", "string") and name not in values:
        return {name: first}
    return {name: first} if style == "equal" and re.fullmatch(r"[-+.\d]+(e[-+]?\d+)?", first) else {}


def _substitute(line: str, values: dict[str, str]) -> str:
    """Line with the values of variables in place of their names, unless nested variables would make it too long."""
    room = LONGEST_LINE

    def value(match: re.Match) -> str:
        nonlocal room
        found = values.get(match[1] or match[2], match[0])
        room -= len(found)
        return found if room >= 0 else match[0]

    return re.sub(r"\$(?:\{(\w+)\}|(\w))", value, line)


def _apply(run: Run, tokens: list[str], place: str) -> Run:
    """Run with the settings after one more command."""
    key, rest = tokens[0], tokens[1:]
    if key == VERSION:  # another run, appended to the log
        return _empty(run.source, int(rest[-1]))
    if key == LATTICE:  # the log gives the spacing with eight digits
        run.settings[LATTICE] = run.settings.get(LATTICE) or rest
        return run
    if key == BONDS:
        run.acts[f"{key} {rest[-1]}"] = f"{' '.join(rest)} ({place}) were not imported: {BONDED}"
        return run
    if key == MEMBERS:
        run.groups.get(rest[-1], []).append(["count", rest[0]])
        return run
    run.met[group_of("command", key)].add(key)
    if key in ABOUT_BONDS and rest[:1] != ["CPU"]:  # not a report of the time that a command took
        run.bonds.append([place, *tokens])
    # groups whose members have different ids or types after the command
    retyped = key == "create_atoms" or (key == "set" and any(word.startswith("type") for word in rest[2:]))
    renumbered = key in (*RENUMBERING, *RELABELING) and " ".join(rest[-2:]) != "compress no"
    for lines in run.groups.values() if retyped or renumbered else ():
        if any(words[0] == "type" or (renumbered and words[0] == "id") for words in lines):
            lines.append(["changed"])
    if key == "clear":
        return _empty(run.source, run.year)._replace(met=run.met)
    if key == "pair_style" and rest:
        run.places[key] = place
        style = plain_style(rest[0])
        kept = run.pair_coeff if run.pair_style[:1] == [style] else []
        return run._replace(pair_style=[style, *rest[1:]], pair_coeff=kept)
    if key in FORCE_STYLES:
        row = find_row("style beside the pair style", plain_style(rest[0]) if rest else "none")
        run.acts.pop(key, None)  # a new style replaces the previous one
        if row.group == UNKNOWN:
            run.acts[key] = f"{key} {' '.join(rest[:2])} ({place}) was not imported: {row.why}"
    elif group_of("command", key) == UNKNOWN:
        why = find_row("command", key).why or "it is unknown"
        run.acts[" ".join(tokens)] = f"{' '.join(tokens[:6])} ({place}) was not imported: {why}"
    elif key == "pair_coeff" and len(rest) > 1:
        run.pair_coeff.append(rest)
    elif key in ("fix", "unfix", "group", "region"):
        _define(run, key, rest, place)
    elif key in ("dump", "write_dump", "dump_modify"):
        _define_dump(run, key, rest)
    else:
        _set(run, key, rest)
    return run


def _set(run: Run, key: str, rest: list[str]) -> None:
    """Evaluate a command that changes a setting."""
    if rest and key in ("units", "atom_style", "newton", "boundary", "dimension"):
        run.settings[key] = [*map(plain_style, rest)]
    elif key == "change_box" and "boundary" in rest:
        run.settings["boundary"] = rest[rest.index("boundary") + 1 :][:3]
    elif key == "neigh_modify" and "exclude" in rest:
        part = " ".join(rest[rest.index("exclude") + 1 :][:3])
        run.settings["exclude"] = [] if part.startswith("none") else [*run.settings.get("exclude", []), part]
    elif key == "labelmap" and rest[:1] == ["atom"]:
        run.labels.update(
            {label: int(number) for number, label in zip(rest[1::2], rest[2::2], strict=False) if number.isdecimal()}
        )
    elif key == "labelmap" and rest[:1] == ["clear"]:
        run.labels.clear()
    elif key == "lattice":
        style, scale, settings = rest[0] if rest else "", (*numbers_in(rest[1:]), 0.0)[0], run.settings
        settings[LATTICE] = rest[1:2] * 3 if style == "none" else []  # other spacings may be in the next line of a log
        if style in NODES and len(rest) == 2 and scale > 0:
            if settings.get("units", ["lj"]) == ["lj"]:  # the number is a density
                scale = (NODES[style] / scale) ** (1 / (2 if settings.get("dimension") == ["2"] else 3))
            settings[LATTICE] = [repr(scale)] * 3


def _define(run: Run, key: str, rest: list[str], place: str) -> None:
    """Evaluate a command that defines or removes a named object."""
    if key == "fix" and len(rest) > 2:
        run.places[rest[0]] = place
        run.fixes[rest[0]] = [rest[1], plain_style(rest[2]), *rest[3:]]
    elif key == "unfix" and rest:
        run.fixes.pop(rest[0], None)
    elif key in ("group", "region") and rest[1:2] == ["delete"]:
        (run.groups if key == "group" else run.regions).pop(rest[0], None)
    elif key == "group" and len(rest) > 1:
        name, kind, *arguments = rest
        if kind == "clear":
            run.groups[name] = []
        if kind in COMBINED:  # the groups of which it is composed are stored as they are now
            kept = {word: f"{word} {len(run.groups)}" for word in arguments if word != "all"}
            run.groups.update({new: list(run.groups.get(word, [["unknown"]])) for word, new in kept.items()})
            arguments = [kept.get(word, word) for word in arguments]
        run.groups.setdefault(name, []).append([kind, *arguments])
    elif key == "region" and len(rest) > 1:
        run.regions[rest[0]] = Region(rest[1:], run.settings.get(LATTICE))


def _define_dump(run: Run, key: str, rest: list[str]) -> None:
    """Evaluate a command that writes grains, or changes their output."""
    if key == "dump_modify":
        if rest and rest[0] in run.dumps:
            run.dumps[rest[0]] = run.dumps[rest[0]].modified(f"dump_modify {rest[0]}", rest[1:])
        return
    name, at = (rest[0], 4) if key == "dump" else ("", 2)
    if len(rest) > at:
        command = " ".join([key, *rest[: at // 2]])
        dump = Dump(command, rest[at], rest[at + 1 :], _selection(command), {})
        run.dumps[name or rest[at]] = dump if name else dump.modified(key, rest[at + 1 :])


def types_in(word: str, most: int, what: str = "the type {}") -> range:
    """Types up to `most` selected by a word such as 1, *, 2* or 1*3; other words raise ValueError about `what`."""
    low, star, high = word.partition("*")
    if not (low + high).isdecimal() and low + high:
        raise ValueError(f"{what.format(word)} is neither a number nor a label in a labelmap")
    first = int(low or 1)
    return range(first, min(int(high or most) if star else first, most) + 1)


def group_members(run: Run, name: str, ids: np.ndarray | None, types: np.ndarray | None, n: int) -> np.ndarray | None:
    """(n,) mask of the grains in a group defined by type or id, or combined from such groups; None for other groups."""
    if name == "all":
        return np.ones(n, bool)
    members = np.zeros(n, bool)
    for style, *arguments in run.groups.get(name, [["unknown"]]):
        if style in ("type", "id") and (types if style == "type" else ids) is not None:
            members |= _select(*((types + 1, run.numbers(arguments)) if style == "type" else (ids, arguments)))
        elif style in COMBINED:
            parts = [group_members(run, word, ids, types, n) for word in arguments]
            if any(part is None for part in parts) or not parts:
                return None
            if style == "intersect":
                members |= np.all(parts, axis=0)
            else:
                others = np.any([np.zeros(n, bool), *parts[1:]], axis=0)
                members = members | parts[0] | others if style == "union" else (members | parts[0]) & ~others
        elif style == "count" and members.sum() == int(arguments[0]):
            continue
        elif style not in ("empty", "clear"):
            return None
    return members


def _select(numbers: np.ndarray, tokens: list[str]) -> np.ndarray:
    """Mask of the numbers selected by arguments such as 3, 1:10 and 2*5, or by a comparison."""
    compare = {"<": np.less, ">": np.greater, "<=": np.less_equal, ">=": np.greater_equal, "==": np.equal}
    if tokens and tokens[0] in (*compare, "!="):
        return compare[tokens[0]](numbers, int(tokens[1])) if tokens[0] in compare else numbers != int(tokens[1])
    chosen = np.zeros(len(numbers), bool)
    for word in tokens:
        low, *more = (int(part or 0) for part in re.split("[:*]", word))
        high = (more[0] or numbers.max()) if more else low
        chosen |= (numbers >= low) & (numbers <= high) & ((numbers - low) % (more[1] if len(more) > 1 else 1) == 0)
    return chosen
