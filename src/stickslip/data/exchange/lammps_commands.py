"""Commands of a run of LAMMPS, from its log or its input script: what holds at the end of it."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .content import read_lines

LOG = re.compile(r"\ALAMMPS \(|\A[^\n]*OMP_NUM_THREADS")
RAN = re.compile(r"(?m)^(Per MPI rank memory allocation|Loop time of \S+ on) ")
UNRESOLVED = re.compile(r"\$\{?[({\w]")


class Run(NamedTuple):
    """Commands that hold at the end of a run."""

    source: str  # name of the log or script
    pair_style: list[str]  # style and arguments; empty if none was given
    pair_coeff: list[list[str]]
    fixes: dict[str, list[str]]  # group, style and the words that follow, by id
    groups: dict[str, list[list[str]]]  # words of each command `group`, by name
    regions: dict[str, list[str]]
    settings: dict[str, list[str]]  # words of units, boundary, atom_style, newton
    unknown: list[str]  # commands whose outcome or variables have no value here
    year: int = 0  # of the version of LAMMPS; 0: unknown


def recognize_log(text: str) -> bool:
    """Return True for a log, in which LAMMPS repeats its commands with the values of variables.

    One that a command `log` began has no line with the version.
    """
    return bool(LOG.search(text[:200]) or RAN.search(text))


def recognize_script(text: str) -> bool:
    """Return True for an input script of grains."""
    return bool(re.search(r"(?m)^\s*(pair_style|atom_style|read_data|read_restart)\s", text))


def read_commands(path: Path, until: str = "", before: Sequence[Path] = ()) -> Run:
    """Replay the commands of a log or an input script, up to the one that wrote the file named `until`.

    `before` are logs of the same run that were written before this one.
    """
    text = "\n".join(map(read_lines_of, (*before, path)))
    version = re.match(r"LAMMPS \(\d+ \w+ (\d{4})", text)
    run = Run(path.name, [], [], {}, {}, {}, {}, [], int(version[1]) if version else 0)
    values, is_log = {}, recognize_log(text)
    for line in re.sub(r"&[ \t]*\n", " ", text).split("\n"):
        tokens = line.partition("#")[0].split()
        if not tokens:
            continue
        if tokens[0] == "variable" and len(tokens) > 3:
            values |= _value(tokens, values)
        if UNRESOLVED.search(line) and not is_log:
            line = _substitute(line, values)
            tokens = line.partition("#")[0].split()
        if not is_log and tokens[0] in ("include", "if", "jump") and tokens[1:2] != ["SELF"]:
            run.unknown.append(" ".join(tokens))
        if UNRESOLVED.search(line):
            if not is_log and tokens[0] in ("fix", "pair_style", "pair_coeff"):
                run.unknown.append(" ".join(tokens))
            continue
        run = _apply(run, [word.strip('"') for word in tokens])
        if until and tokens[0] in ("write_restart", "write_data") and tokens[1:2] == [until]:
            break
    return run


def read_lines_of(path: Path) -> str:
    """Text of a log or script, whose last line may lack its end."""
    try:
        return read_lines(path)
    except ValueError:
        return path.read_text(encoding="utf-8", errors="replace").replace("\r\n", "\n")


def _value(tokens: list[str], values: dict[str, str]) -> dict[str, str]:
    """Value of a variable that has one without running LAMMPS."""
    name, style, first = tokens[1], tokens[2], _substitute(tokens[3], values).strip('"')
    if style in ("index", "string") and name not in values:
        return {name: first}
    return {name: first} if style == "equal" and re.fullmatch(r"[-+.\d]+(e[-+]?\d+)?", first) else {}


def _substitute(line: str, values: dict[str, str]) -> str:
    return re.sub(r"\$(?:\{(\w+)\}|(\w))", lambda m: values.get(m[1] or m[2], m[0]), line)


def _apply(run: Run, tokens: list[str]) -> Run:
    """Run after one more command."""
    key, rest = tokens[0], tokens[1:]
    if key in ("units", "boundary", "atom_style", "newton"):
        run.settings[key] = rest
    elif key == "neigh_modify" and "exclude" in rest:
        part = " ".join(rest[rest.index("exclude") + 1 :][:3])
        run.settings["exclude"] = [] if part.startswith("none") else [*run.settings.get("exclude", []), part]
    elif key == "clear":
        return Run(run.source, [], [], {}, {}, {}, {}, [], run.year)
    elif key == "pair_style" and rest:
        return run._replace(pair_style=rest, pair_coeff=[])
    elif key == "pair_coeff" and len(rest) > 1:
        run.pair_coeff.append(rest)
    elif key == "fix" and len(rest) > 2:
        run.fixes[rest[0]] = rest[1:]
    elif key == "unfix" and rest:
        run.fixes.pop(rest[0], None)
    elif key == "group" and len(rest) > 1:
        run.groups.setdefault(rest[0], []).append(rest[1:])
    elif key == "region" and len(rest) > 1:
        run.regions[rest[0]] = rest[1:]
    return run


def group_members(run: Run, name: str, ids: np.ndarray | None, types: np.ndarray | None, n: int) -> np.ndarray | None:
    """(n,) bool, members of a group that is chosen by type or id, or combined from such groups; None for others."""
    if name == "all":
        return np.ones(n, bool)
    members = np.zeros(n, bool)
    for style, *arguments in run.groups.get(name, [["unknown"]]):
        if style in ("type", "id") and (types if style == "type" else ids) is not None:
            members |= _select(types + 1 if style == "type" else ids, arguments)
        elif style in ("union", "subtract", "intersect"):
            parts = [group_members(run, word, ids, types, n) for word in arguments if word != name]
            if any(part is None for part in parts) or not parts:
                return None
            others = np.any([np.zeros(n, bool), *parts[1:]], axis=0)
            members |= {"union": parts[0] | others, "subtract": parts[0] & ~others, "intersect": np.all(parts, axis=0)}[
                style
            ]
        elif style not in ("empty", "clear"):
            return None
    return members


def _select(numbers: np.ndarray, tokens: list[str]) -> np.ndarray:
    """Mask of the numbers that are meant by arguments such as 3, 1:10 and 2*5, or by a comparison."""
    compare = {"<": np.less, ">": np.greater, "<=": np.less_equal, ">=": np.greater_equal, "==": np.equal}
    if tokens and tokens[0] in (*compare, "!="):
        return compare[tokens[0]](numbers, int(tokens[1])) if tokens[0] in compare else numbers != int(tokens[1])
    chosen = np.zeros(len(numbers), bool)
    for word in tokens:
        low, *more = (int(part or 0) for part in re.split("[:*]", word))
        high = (more[0] or numbers.max()) if more else low
        chosen |= (numbers >= low) & (numbers <= high) & ((numbers - low) % (more[1] if len(more) > 1 else 1) == 0)
    return chosen
