"""Numbers in README and documentation: their sources, and their age relative to the code.

`docs/numbers/NAME.json` contains the numbers of one command, with commit, date, processor and a hash of each room of
`src/stickslip` on which they depend. Pages show a number as a link, `[2.3](numbers.md#NAME "key")`, whose text is
written from the store. Text between `<!-- measured by NAME -->` and `<!-- end -->` was transcribed by hand, and is
stored as a hash; text after `<!-- written by python -m benchmarks NAME -->` is written by the benchmark.

    python -m benchmarks.records                 # numbers older than their rooms, and the time to measure them again
    python -m benchmarks.records --rerun 10m     # measure again, cheapest first, as many as fit into ten minutes
    python -m benchmarks.records --write         # only write the numbers into the pages
    python -m benchmarks.records --transcribed NAME   # text measured by NAME now has the numbers of the stored run
    python -m benchmarks.records --ran NAME           # the `stickslip` command of NAME has run on this code, and the
                                                      # pages have its numbers
"""

import argparse
import ast
import hashlib
import json
import math
import os
import platform
import re
import subprocess
import sys
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from stickslip._core import build

ROOT = Path(__file__).parents[1]
CODE = {".py", ".cpp", ".h", ".cu"}
LINK = re.compile(r'\[([^\]]*)\]\(((?:[\w./]*/)?numbers\.md)#([\w-]+) "([^"]+)"\)')
BLOCK = re.compile(r"<!-- (measured by|written by python -m benchmarks) (\w+)[^>]*-->(.*?)<!-- end -->", re.S)
COMMON = ("command", "commit", "date", "processor", "rooms", "modules")
NOT_RECORDED = "not recorded"  # processor of a number that is older than these records
DIGITS = 2  # significant digits, unless an entry states others
console = Console()


@cache
def _code(path: Path, _modified: int) -> str:
    """Text of a source file without comments and spaces; for Python also without docstrings, messages, local names."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        return _plain(_WithoutWords().visit(ast.parse(text)))
    return " ".join(re.sub(r"//[^\n]*|/\*.*?\*/", "", text, flags=re.S).split())


class _WithoutWords(ast.NodeTransformer):
    """Remove docstrings and the messages of errors, and number the local variables of functions."""

    local: dict[str, str] | None = None  # new names of the local variables of the outermost function

    def _with_body(self, node):
        if ast.get_docstring(node, clean=False) is not None:
            node.body = node.body[1:]
        return self.generic_visit(node)

    visit_Module = visit_ClassDef = _with_body  # noqa: N815 (names of Python's syntax)

    def visit_FunctionDef(self, node):
        if self.local is not None:
            return self._with_body(node)
        inner = list(ast.walk(node))
        named = (one for one in inner if not isinstance(one, ast.Name | ast.Attribute | ast.keyword | ast.Constant))
        fields = (value for one in named for _, value in ast.iter_fields(one))
        fixed = {name for one in fields for name in (one if isinstance(one, list) else [one]) if isinstance(name, str)}
        stored = [one.id for one in inner if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store)]
        self.local = {name: f"_{k}" for k, name in enumerate(dict.fromkeys(stored)) if name not in fixed}
        self._with_body(node)
        self.local = None
        return node

    def visit_Name(self, node):
        node.id = (self.local or {}).get(node.id, node.id)
        return node

    def visit_Raise(self, node):
        if isinstance(node.exc, ast.Call):
            node.exc.args = [one for one in node.exc.args if not _is_text(one)]
        return self.generic_visit(node)


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def _plain(node) -> str:
    """Syntax tree as text, the same for all versions of Python."""
    if isinstance(node, list):
        return f"[{' '.join(map(_plain, node))}]"
    if not isinstance(node, ast.AST):
        return repr(node)
    parts = (f"{name}={_plain(one)}" for name, one in ast.iter_fields(node) if one not in (None, []))
    return f"{type(node).__name__}({' '.join(parts)})"


def files_of(room: str, root: Path = ROOT) -> list[Path]:
    """Source files of a room; raise FileNotFoundError if there are none."""
    place = root / "src" / "stickslip" / room
    files = [place] if place.is_file() else [*place.rglob("*"), place.with_name(f"{place.name}.py")]
    code = sorted(path for path in files if path.is_file() and path.suffix in CODE and ".objects" not in path.parts)
    if not code:
        raise FileNotFoundError(f"src/stickslip has no room {room!r}")
    return code


def fingerprint(room: str, root: Path = ROOT, modules: str | None = None) -> str:
    """Hash of the code of a room (a folder or file of `src/stickslip`), without comments and docstrings.

    With `modules`, separated by spaces, only these files of Python code are included.
    """
    code = files_of(room, root)
    if modules is not None:
        used = {root / "src" / "stickslip" / name for name in modules.split()}
        code = [path for path in code if path.suffix != ".py" or path in used]
    found = hashlib.sha256()
    for path in code:
        found.update(f"{path.relative_to(root)}\n{_code(path, path.stat().st_mtime_ns)}\n".encode())
    return found.hexdigest()[:12]


def imported(rooms, root: Path = ROOT) -> str:
    """Python files of some rooms that this process has imported, separated by spaces."""
    package = root / "src" / "stickslip"
    paths = (Path(file) for one in list(sys.modules.values()) if (file := getattr(one, "__file__", None)))
    names = (path.relative_to(package).as_posix() for path in paths if package in path.parents)
    return " ".join(sorted(name for name in names if any(f"{name}/".startswith((f"{r}/", f"{r}.py/")) for r in rooms)))


def folder(root: Path = ROOT) -> Path:
    """Folder of the stored numbers."""
    return root / "docs" / "numbers"


def read(root: Path = ROOT) -> dict[str, dict]:
    """Read the records of all commands by name."""
    return {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder(root).glob("*.json"))}


def entries(record: dict) -> dict[str, dict]:
    """Entries of a record by key; each number inherits the common fields that it does not have itself."""
    common = {key: record[key] for key in COMMON if key in record}
    return {key: common | one for key, one in record["values"].items()}


def changed(entry: dict, root: Path = ROOT) -> list[str]:
    """Rooms whose code is unknown or has changed since a record or number was measured; missing rooms are marked."""
    out = []
    for room, known in entry["rooms"].items():
        try:
            out += [room] if known != fingerprint(room, root, entry.get("modules")) else []
        except FileNotFoundError:
            out.append(f"{room} (no longer there)")
    return out


def stale(record: dict, root: Path = ROOT) -> dict[str, list[str]]:
    """Changed rooms of each outdated number, by key."""
    found = {key: changed(one, root) for key, one in entries(record).items()}
    return {key: rooms for key, rooms in found.items() if rooms}


def processor() -> str:
    """Name and number of cores of the processor."""
    try:
        name = re.search(r"model name\s*: (.+)", Path("/proc/cpuinfo").read_text(encoding="utf-8"))[1]
    except (OSError, TypeError):
        name = platform.processor() or platform.machine()
    return f"{name}, {os.cpu_count()} cores, {build.best_level()}"


def commit(root: Path = ROOT) -> str:
    """Commit of the code, with `-dirty` if the package or the benchmarks differ from it."""

    def git(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=root, capture_output=True, text=True).stdout.strip()

    return git("rev-parse", "--short", "HEAD") + ("-dirty" if git("status", "--porcelain", "src", "benchmarks") else "")


def texts(name: str, root: Path = ROOT, *, kind: str = "") -> dict[str, dict]:
    """Hashes of page text measured by a command, under the key `text of PAGE`; `kind` as in the marks."""
    found: dict[str, list[str]] = {}  # without the numbers of links, which are written later
    for path in pages(root):
        for how, one, body in BLOCK.findall(path.read_text(encoding="utf-8")):
            if one == name and how.startswith(kind):
                found.setdefault(f"text of {path.relative_to(root).as_posix()}", []).append(
                    " ".join(LINK.sub(r'[](\2#\3 "\4")', body).split())
                )
    return {key: {"text": hashlib.sha256("\n".join(bodies).encode()).hexdigest()[:12]} for key, bodies in found.items()}


def store(
    name: str, command: str, rooms, values: dict[str, dict], seconds: float, lines=(), modules=None, root: Path = ROOT
) -> Path:
    """Write the numbers and lines of a run; other numbers keep their dates, and all keep the digits shown.

    The numbers depend on `rooms`, and among the Python files there only on `modules`, unless that list is None. Page
    text that was transcribed from the previous run gets the date of this one if both have the same lines and numbers,
    except times, which pages show as links.
    """
    path = folder(root) / f"{name}.json"
    values = values | texts(name, root, kind="written")
    old = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {"values": {}}
    common = {
        "command": command, "commit": commit(root),
        "date": datetime.now(UTC).date().isoformat(), "processor": processor(),
        "rooms": {room: fingerprint(room, root, modules) for room in rooms}, "modules": modules,
    }  # fmt: skip
    fixed = {key: one for key, one in values.items() if one.get("unit") != "s"}
    same = all(old["values"].get(key, {}) | one == old["values"].get(key) for key, one in fixed.items())
    if same and old.get("lines", []) == list(lines):
        values |= {key: one for key, one in old["values"].items() if one.keys() == {"text"}}
    kept = {}
    for key, one in (entries(old) if old["values"] else {}).items():
        if key in values:
            values[key] = {k: v for k, v in one.items() if k == "digits"} | values[key]
        else:
            kept[key] = {k: v for k, v in ({"modules": None} | one).items() if k not in common or v != common[k]}
    record = common | {"seconds": round(seconds, 1), "values": kept | values}
    record |= {"lines": list(lines)} if lines else {}
    return _save(path, record)


def transcribed(name: str, root: Path = ROOT) -> Path:
    """Give page text measured by a command the date of the stored run of that command."""
    record = read(root)[name]
    return _save(folder(root) / f"{name}.json", record | {"values": record["values"] | texts(name, root)})


def ran(name: str, root: Path = ROOT) -> Path:
    """Give page text measured by a `stickslip` command, which does not store its runs, the date and code of now."""
    record = read(root)[name]
    if not record["command"].startswith("stickslip "):
        raise ValueError(f"`{record['command']}` stores its runs: use --store, then --transcribed {name}")
    store(name, record["command"], record["rooms"], {}, record["seconds"], root=root)
    return transcribed(name, root)


def _save(path: Path, record: dict) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return path


def measured(row: dict) -> dict[str, dict]:
    """Numbers in a benchmark row by key: the value, and its ratio to a peer."""
    if "value" in row:
        return {row["case"]: {k: v for k, v in row.items() if k != "case" and v is not None}}
    many = (f", {row['n']:,}" if row["n"] >= 1e4 else f", {row['n']}") if row["n"] else ""
    case = f"{row['case']}{many}" + (f", {row['threads']} threads" if row["threads"] > 1 else "")
    found = {case: {"value": _rounded(row["ours"]), "unit": row["unit"]}}
    if row["ratio"] is not None:
        found[f"{case}, ratio to {row['peer_name'].split(' (')[0]}"] = {"value": _rounded(row["ratio"]), "unit": ""}
    return found


def number(case: str, value: float, unit: str = "", error: float | None = None) -> dict:
    """Benchmark row: a number with unit and error."""
    more = {} if error is None else {"error": _rounded(error)}
    return {"case": case, "value": _rounded(value), "unit": unit} | more


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")


def shown(one: dict) -> str:
    """Number as shown on pages, without unit."""
    value, digits = one["value"], one.get("digits", DIGITS)
    size = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}")))) if value else 0
    if not -4 < size < 7:
        text = f"{value:.{digits - 1}e}".replace("e-0", "e-").replace("e+0", "e")
    else:
        decimals = max(digits - 1 - size, 0)
        text = f"{value:,.{decimals}f}" if abs(value) >= 1e4 else f"{value:.{decimals}f}"
        if "error" in one:
            text += f" ± {one['error']:.{decimals}f}"
    return text.replace("-", "−", 1) if value < 0 else text


def pages(root: Path = ROOT) -> list[Path]:
    """Hand-written pages that contain numbers: README, paper and documentation."""
    made = {"numbers.md"}
    found = [p for p in sorted((root / "docs").rglob("*.md")) if not {"_build", "api", "reference"} & {*p.parts}]
    first = [path for path in (root / "README.md", root / "paper" / "paper.md") if path.exists()]
    return [*first, *(path for path in found if path.name not in made)]


def with_numbers(text: str, records: dict[str, dict]) -> str:
    """Text of a page with stored numbers; raise KeyError if a number is not stored."""

    def link(found: re.Match) -> str:
        _, page, name, key = found.groups()
        if key not in records.get(name, {"values": ()})["values"]:
            raise KeyError(f"docs/numbers/{name}.json has no number {key!r}")
        return f'[{shown(records[name]["values"][key])}]({page}#{name} "{key}")'

    return LINK.sub(link, text)


def overview(records: dict[str, dict]) -> str:
    """Text of the page that lists all numbers."""
    lines = [
        "# Measured numbers",
        "",
        "This page lists the measured numbers in README and documentation, each with the command that measures it.",
        "Numbers in the text link to this page; the title of each link is the name of the number. Entries *text of* a",
        "page are for text that was transcribed from the output of a command, or written by it. For numbers older than",
        "these records, date and commit are those of the record, and the processor is missing. `make numbers` lists",
        "the numbers that are older than the code.",
    ]
    for name, record in records.items():
        lines += ["", f"## {name}", "", f"`{record['command']}`"]
        groups: dict[tuple, list[str]] = {}
        for key, one in entries(record).items():
            known = one["processor"] != NOT_RECORDED
            about = f"{'Measured' if known else 'Recorded'} on {one['date']} at commit `{one['commit']}`"
            about += f", {one['processor']}:" if known else ":"
            groups.setdefault(about, []).append(_line(key, one))
        for about, rows in groups.items():
            lines += ["", about, "", *rows]
    return "\n".join(lines) + "\n"


def _line(key: str, one: dict) -> str:
    """Line of a number in the overview; text of a page is a link to the page."""
    if "text" in one:
        page = key.removeprefix("text of ")
        place = page.removeprefix("docs/")
        return f"- text of `{page}`" if place == page else f"- text of [{page}]({place})"  # links stay within docs
    return f"- {key}: {shown(one)} {one['unit']}".rstrip()


def older(records: dict[str, dict], root: Path = ROOT) -> str:
    """Section of the page that names the numbers older than the code."""
    lines = [
        "",
        "## Older than the code",
        "",
        "Code on which these numbers depend has changed since they were measured:",
        "",
    ]
    for name, record in records.items():
        if found := stale(record, root):
            rooms = ", ".join(f"`{room}`" for room in sorted({one for rooms in found.values() for one in rooms}))
            what = "all" if len(found) == len(record["values"]) else "; ".join(found)
            lines.append(f"- [{name}](#{name}): {what} ({rooms})")
    return "\n".join(lines) + "\n"


def write_block(page: Path, name: str, text: str) -> None:
    """Replace page text written by a benchmark."""
    mark = f"<!-- written by python -m benchmarks {name} -->\n"
    head, begin, rest = page.read_text(encoding="utf-8").partition(mark)
    if not begin:
        raise ValueError(f"{page} has no line {mark.strip()!r}, after which the text belongs")
    _, end, tail = rest.partition("<!-- end -->")
    page.write_text(f"{head}{begin}\n{text.rstrip()}\n\n{end}{tail}", encoding="utf-8")


def write(root: Path = ROOT) -> list[Path]:
    """Write stored numbers into all pages; return the changed pages."""
    records, out = read(root), []
    texts = {path: with_numbers(path.read_text(encoding="utf-8"), records) for path in pages(root)}
    for path, text in (texts | {root / "docs" / "numbers.md": overview(records)}).items():
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
            out.append(path)
    return out


def stale_in_readme(root: Path = ROOT) -> list[str]:
    """One sentence per number in the README that is older than the code; a release requires an empty list."""
    records, out = read(root), []
    for text, _, name, key in LINK.findall((root / "README.md").read_text(encoding="utf-8")):
        if rooms := stale(records[name], root).get(key):
            command = records[name]["command"]
            out.append(f"README.md: {text} ({key}) is older than {', '.join(rooms)}: run `{command} --store`")
    return out


def seconds_of(words: str) -> float:
    """Seconds in a time such as 10m, 90s or 1.5h; raise ValueError for other text."""
    found = re.fullmatch(r"([\d.]+)([smh])", words)
    if not found:
        raise ValueError(f"the time was {words!r}: write it as in 90s, 10m or 2h")
    return float(found[1]) * {"s": 1, "m": 60, "h": 3600}[found[2]]


def affordable(costs: dict[str, float], limit: float) -> list[str]:
    """Names whose total cost is within a limit, cheapest first."""
    out = []
    for name, cost in sorted(costs.items(), key=lambda one: one[1]):
        if cost > limit:
            break
        limit -= cost
        out.append(name)
    return out


def main() -> None:
    """List stale numbers, or measure them again."""
    parser = argparse.ArgumentParser(description="Numbers of the documentation that are older than the code.")
    parser.add_argument("--rerun", metavar="TIME", help="measure again as much as fits into this time, as in 10m")
    parser.add_argument("--write", action="store_true", help="only write the numbers into the pages")
    parser.add_argument("--transcribed", metavar="NAME", help="text measured by NAME has the numbers of the stored run")
    parser.add_argument(
        "--ran", metavar="NAME", help="the stickslip command of NAME has run; the pages have its numbers"
    )
    given = parser.parse_args()
    if given.transcribed:
        transcribed(given.transcribed)
    if given.ran:
        ran(given.ran)
    if given.write or given.transcribed or given.ran:
        console.print(*(f"Written: {path.relative_to(ROOT)}" for path in write()), sep="\n")
        return
    try:
        limit = seconds_of(given.rerun) if given.rerun else 0.0
    except ValueError as problem:
        parser.error(str(problem))
    records = read()
    found = {name: one for name, record in records.items() if (one := stale(record))}
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for head in ("command", "stale", "changed", "processor time [s]"):
        table.add_column(head, justify="right" if head in ("stale", "processor time [s]") else "left", overflow="fold")
    for name in sorted(found, key=lambda one: records[one]["seconds"]):
        rooms = sorted({room for rooms in found[name].values() for room in rooms})
        record = records[name]
        count = f"{len(found[name])} of {len(record['values'])}"
        table.add_row(record["command"], count, ", ".join(rooms), f"{record['seconds']:,.0f}")
    console.print(table if found else "No number is older than the code.")
    ours = {  # other commands belong to users, or require transcription by hand
        name: records[name]["seconds"]
        for name in found
        if records[name]["command"].startswith("python -m ") and changed(records[name])
    }
    for name in affordable(ours, limit):
        console.print(f"[bold]{records[name]['command']}[/]")
        subprocess.run([sys.executable, *records[name]["command"].split()[1:], "--store"], cwd=ROOT)


if __name__ == "__main__":
    main()
