"""Numbers in README and docs come from the store, and the store knows which of them are older than the code."""

import importlib
import json
import re
import tomllib
from collections import Counter
from pathlib import Path

import pytest

from benchmarks import BENCHMARKS, records

ROOT = records.ROOT


@pytest.fixture
def tree(tmp_path):
    """A package with two rooms, a stored number of one of them, and pages that show it."""
    for room in ("core", "solve"):
        (tmp_path / "src" / "stickslip" / room).mkdir(parents=True)
        (tmp_path / "src" / "stickslip" / room / "a.py").write_text('"""Doc."""\n\n\ndef f():\n    return 1\n')
    (tmp_path / "docs").mkdir()
    (tmp_path / "README.md").write_text('It is [?](docs/numbers.md#speed "ratio") times as fast.\n')
    records.store(
        "speed", "python -m benchmarks speed", ["core"], {"ratio": {"value": 2.34, "unit": ""}}, 5.0, root=tmp_path
    )
    return tmp_path


def write_code(tree, text: str, room="core") -> None:
    (tree / "src" / "stickslip" / room / "a.py").write_text(text)


@pytest.mark.parametrize(
    ("text", "room", "old"),
    [
        ('"""Doc."""\n\n\ndef f():\n    return 2\n', "core", True),
        ('"""Doc."""\n\n\ndef f():\n    return 2\n', "solve", False),
        ('"""Another\n\ntext.\n"""\n\n\ndef f():  # why\n    """And here."""\n\n    return 1\n', "core", False),
        ('"""Doc."""\n\n\ndef f():\n    x = """text"""\n    return 1\n', "core", True),
        ('def f():\n    if 0:\n        raise ValueError(f"{0}: text")\n    return 1\n', "core", True),
    ],
)
def test_a_number_is_older_than_a_room_whose_code_changed(tree, text, room, old):
    assert records.stale(records.read(tree)["speed"], tree) == {}
    write_code(tree, text, room)
    assert records.stale(records.read(tree)["speed"], tree) == ({"ratio": ["core"]} if old else {})
    assert bool(records.stale_in_readme(tree)) is old


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ('def f(n):\n    """Doc."""\n    b = n\n    raise ValueError(f"{b} is bad")\n', True),
        ('def f(n):\n    a = n\n    raise ValueError("it is bad")  # why\n', True),
        ('def f(n):\n    a = n\n    raise TypeError(f"{a}: text")\n', False),
        ('def f(k):\n    a = k\n    raise ValueError(f"{a}: text")\n', False),  # users may write f(n=1)
        ('def f(n):\n    a = 2 * n\n    raise ValueError(f"{a}: text")\n', False),
        ('def f(n):\n    a = n\n    raise ValueError(f"{a}: text", a)\n', False),
        ('def f(n):\n    a = n\n    raise ValueError(f"{a}: text", 2)\n', False),  # as in the code of an exit
    ],
)
def test_messages_and_local_names_do_not_count(tree, text, same):
    write_code(tree, 'def f(n):\n    a = n\n    raise ValueError(f"{a}: text")\n')
    before = records.fingerprint("core", tree)
    write_code(tree, text)
    assert (records.fingerprint("core", tree) == before) is same


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("a, b = n\n    return a - b", "a, b = n\n    return b - a"),
        ("a = b = n\n    return [c - a for c in b]", "a = b = n\n    return [c - b for c in b]"),
        ("a = n\n    match n:\n        case (b, c): return b", "a = n\n    match n:\n        case (a, c): return a"),
        ("global a\n    a = n", "global b\n    b = n"),
    ],
)
def test_variables_that_are_exchanged_count(tree, one, other):
    hashes = set()
    for text in (one, other):
        write_code(tree, f"def f(n):\n    {text}\n")
        hashes.add(records.fingerprint("core", tree))
    assert len(hashes) == 2


def test_a_number_depends_only_on_the_modules_of_its_run(tree):
    (tree / "src" / "stickslip" / "core" / "b.py").write_text("x = 1\n")
    (tree / "src" / "stickslip" / "core" / "c.cpp").write_text("int x;\n")
    values = {"ratio": {"value": 1.0, "unit": ""}}
    records.store("speed", "c", ["core"], values, 1.0, modules="core/a.py", root=tree)
    (tree / "src" / "stickslip" / "core" / "b.py").write_text("x = 2\n")
    assert records.stale(records.read(tree)["speed"], tree) == {}
    (tree / "src" / "stickslip" / "core" / "c.cpp").write_text("long x;\n")
    assert records.stale(records.read(tree)["speed"], tree) == {"ratio": ["core"]}
    records.store("speed", "c", ["core"], values, 1.0, modules="core/a.py", root=tree)
    write_code(tree, "x = 1\n")
    assert records.stale(records.read(tree)["speed"], tree) == {"ratio": ["core"]}
    importlib.import_module("stickslip.solve.birth")
    found = records.imported(["core", "solve/birth", "solve/inver"]).split()
    assert {"core/state.py", "solve/birth.py"} <= {*found} and "solve/newton.py" not in found


def test_comments_and_spaces_of_the_compiled_core_do_not_count(tree):
    path = tree / "src" / "stickslip" / "core" / "a.cpp"
    hashes = []
    for text in ("int f() { return 1; }\n", "// why\nint f() {\n  return 1; /* one */ }", "int f() { return 2; }"):
        path.write_text(text)
        hashes.append(records.fingerprint("core", tree))
    assert hashes[0] == hashes[1] != hashes[2]
    with pytest.raises(FileNotFoundError, match="src/stickslip has no room 'none'"):
        records.fingerprint("none", tree)


def test_a_number_of_a_room_that_moved_is_stale_and_says_so(tree):
    place = tree / "src" / "stickslip"
    (place / "core").rename(place / "heart")
    record = records.read(tree)["speed"]
    assert records.stale(record, tree) == {"ratio": ["core (no longer there)"]}
    assert "ratio) is older than core (no longer there): run `python" in records.stale_in_readme(tree)[0]
    assert "(`core (no longer there)`)" in records.older({"speed": record}, tree)
    record["rooms"] = {"heart": record["rooms"].pop("core")}  # the same code under another name is not the measured one
    assert records.stale(record, tree) == {"ratio": ["heart"]}


def test_a_number_that_a_later_run_does_not_have_keeps_its_date(tree):
    path = records.folder(tree) / "speed.json"
    record = json.loads(path.read_text())
    record["values"]["ratio"]["digits"] = 3
    record["values"]["by hand"] = {"value": 7, "unit": "s", "date": "2020-01-01", "rooms": {"core": None}}
    path.write_text(json.dumps(record | {"date": "2021-01-01"}))
    write_code(tree, "x = 1\n")
    records.store("speed", "c", ["core"], {"ratio": {"value": 3.14159, "unit": ""}}, 1.0, root=tree)
    found = records.entries(records.read(tree)["speed"])
    assert found["by hand"]["date"] == "2020-01-01" and found["ratio"]["date"] > "2021"
    assert records.stale(records.read(tree)["speed"], tree) == {"by hand": ["core"]}
    assert records.write(tree) and "[3.14](docs/numbers.md#speed" in (tree / "README.md").read_text()
    assert not records.write(tree)


def test_text_that_was_transcribed_has_the_date_of_its_run(tree):
    (tree / "docs" / "page.md").write_text("<!-- measured by speed -->\n\n| 1 |\n\n<!-- end -->\n")
    records.transcribed("speed", tree)
    assert "text of docs/page.md" in records.read(tree)["speed"]["values"]
    write_code(tree, "x = 1\n")
    records.store("speed", "c", ["core"], {"ratio": {"value": 3, "unit": ""}}, 1.0, root=tree)
    assert records.stale(records.read(tree)["speed"], tree) == {"text of docs/page.md": ["core"]}
    records.transcribed("speed", tree)
    assert records.stale(records.read(tree)["speed"], tree) == {}
    assert "- text of [docs/page.md](page.md)" in records.overview(records.read(tree))


def test_text_from_a_command_of_the_package_has_the_date_of_its_last_run(tree):
    (tree / "docs" / "page.md").write_text("<!-- measured by triaxial -->\n\n| 1 |\n\n<!-- end -->\n")
    records.store("triaxial", "stickslip run a.toml", ["core"], {}, 60.0, root=tree)
    records.transcribed("triaxial", tree)
    write_code(tree, "x = 1\n")
    assert records.stale(records.read(tree)["triaxial"], tree) == {"text of docs/page.md": ["core"]}
    (tree / "docs" / "page.md").write_text("<!-- measured by triaxial -->\n\n| 2 |\n\n<!-- end -->\n")
    record = json.loads(records.ran("triaxial", tree).read_text())
    assert records.stale(record, tree) == {} and record["seconds"] == 60.0
    assert record["values"] == records.texts("triaxial", tree)
    with pytest.raises(ValueError, match="`c` stores its runs: use --store, then --transcribed triaxial"):
        records.store("triaxial", "c", ["core"], {}, 1.0, root=tree)
        records.ran("triaxial", tree)


@pytest.mark.parametrize(("value", "line", "old"), [(2.34, "a", False), (2.34, "b", True), (2.35, "a", True)])
def test_transcribed_text_is_renewed_by_a_run_with_the_same_output(tree, value, line, old):
    (tree / "docs" / "page.md").write_text("<!-- measured by speed -->\n\n| 1 |\n\n<!-- end -->\n")
    records.store("speed", "c", ["core"], {"ratio": {"value": 2.34, "unit": ""}}, 1.0, ["a"], root=tree)
    records.transcribed("speed", tree)
    write_code(tree, "x = 1\n")
    records.store("speed", "c", ["core"], {"ratio": {"value": value, "unit": ""}}, 1.0, [line], root=tree)
    assert records.stale(records.read(tree)["speed"], tree) == ({"text of docs/page.md": ["core"]} if old else {})


@pytest.mark.parametrize(
    ("one", "text"),
    [
        ({"value": 2.34}, "2.3"),
        ({"value": 465.3}, "465"),
        ({"value": 1.75, "digits": 3}, "1.75"),
        ({"value": 9.97}, "10"),
        ({"value": 123456.0}, "123,456"),
        ({"value": -0.0123}, "−0.012"),
        ({"value": 3.2e-7}, "3.2e-7"),
        ({"value": 6.04, "error": 0.98}, "6.0 ± 1.0"),
        ({"value": 0}, "0.0"),
    ],
)
def test_numbers_are_shown_with_their_digits(one, text):
    assert records.shown(one) == text


@pytest.mark.parametrize(("limit", "names"), [(0, []), (6, ["b"]), (15, ["b", "a"]), (1000, ["b", "a", "c"])])
def test_what_fits_is_measured_again_cheapest_first(limit, names):
    assert records.affordable({"a": 10.0, "b": 5.0, "c": 100.0}, limit) == names


def test_times_are_written_with_a_unit():
    assert [records.seconds_of(words) for words in ("90s", "10m", "1.5h")] == [90, 600, 5400]
    with pytest.raises(ValueError, match="the time was '10': write it as in 90s, 10m or 2h"):
        records.seconds_of("10")


def test_pages_show_the_numbers_of_the_store():
    known = records.read()
    for page in records.pages():
        text = page.read_text(encoding="utf-8")
        assert records.with_numbers(text, known) == text, f"{page.name}: python -m benchmarks.records --write"
        for _, name, _ in records.BLOCK.findall(text):
            key = f"text of {page.relative_to(ROOT).as_posix()}"
            stored = known[name]["values"].get(key, {}).get("text")
            assert stored == records.texts(name)[key]["text"], f"python -m benchmarks.records --transcribed {name}"
        assert text.count("<!-- end -->") == len(records.BLOCK.findall(text)) + text.count("<!-- checked by"), page.name
    assert (ROOT / "docs" / "numbers.md").read_text(encoding="utf-8") == records.overview(known)


def test_records_are_of_commands_that_exist():
    for name, record in records.read().items():
        if record["command"].startswith("python -m benchmarks "):
            assert record["command"].split()[3] == name
            source, known, rooms = ROOT / "src" / "stickslip", {*record["rooms"]}, {*BENCHMARKS[name].rooms}
            there = {room for room in known if (source / room).exists() or (source / f"{room}.py").exists()}
            assert there == rooms if there == known else there <= rooms, name
        for one in records.entries(record).values():
            assert one["commit"] and re.fullmatch(r"20\d\d-\d\d-\d\d", one["date"]) and one["processor"]


# Figures that this package may have measured: percentages, ratios, processor or wall time, and sizes of files.
# Lengths, stresses, velocities and angles are inputs and results of physics, and have their tables.
FIGURE = re.compile(
    r"(?<![\w.,^/-])[−+±-]?\d[\d.,]*(?:e[-−]?\d+)?(?:(?: to | and |, | or |–)[−+]?\d[\d.,]*)*"
    r"\s(?:%|×(?! ?[\d(])|times\b|(?:µs|ms|s|seconds?|min|minutes?|h|hours?|kB|MB|GB|bytes)(?![\w/]))"
)
ALLOWED = ROOT / "docs" / "numbers" / "typed.toml"
CITATION = r"doi:|doi\.org|arXiv:|arxiv\.org"
CHECKED = re.compile(r"<!-- checked by (\S+)[^>]*-->.*?<!-- end -->", re.S)


def scope() -> list[Path]:
    """Pages whose numbers are looked at: not those that are generated from the code of scenarios."""
    return [page for page in records.pages() if page.parent.name != "scenario"]


def typed(text: str) -> list[tuple[int, str, str]]:
    """Line numbers, figures and lines of figures that are neither from the store nor from a marked block or paper."""

    def blank(found):
        return "\n" * found[0].count("\n")

    def paper(found):
        return blank(found) if re.search(CITATION, found[0]) else found[0]

    text = re.sub(r"^```.*?^```", blank, text, flags=re.M | re.S)
    text = re.sub(r"(?<=\n\n)(?:    .*\n)+", blank, text)
    text = CHECKED.sub(blank, records.BLOCK.sub(blank, text))
    text = re.sub(r"(?:^(?!\|).+\n)+", paper, text, flags=re.M)  # paragraphs
    text = re.sub(rf"^\|.*(?:{CITATION}).*$", "", text, flags=re.M)
    text = re.sub(r"`[^`]*`|\$\$.*?\$\$|\$[^$\n]*\$", blank, records.LINK.sub("", text), flags=re.S)
    flat = [(found.start(), found[0]) for found in FIGURE.finditer(text)]
    lines = text.splitlines()
    return [(text[:at].count("\n") + 1, " ".join(one.split()), lines[text[:at].count("\n")]) for at, one in flat]


def test_a_typed_number_is_found_and_a_stored_one_is_not():
    link = '[2.3](numbers.md#engine "key")'
    assert [one for _, one, _ in typed("It is 2.5 times as fast, and takes 3 s or 4 %.\n")] == [
        "2.5 times",
        "3 s",
        "4 %",
    ]
    assert not typed(f"It is {link} times as fast.\n\n    3 s\n\nA. B. (doi:10.1/2) have 3 %.\n")
    assert not typed("<!-- measured by engine -->\n\n| 3 % |\n\n<!-- end -->\n\nAt 10 MPa and 30°, 6 × 6.\n")


def test_figures_come_from_the_store_a_test_a_paper_or_the_list():
    reasons = tomllib.loads(ALLOWED.read_text(encoding="utf-8"))
    everywhere, allowed = reasons.pop("everywhere")["figures"], Counter()
    for group in reasons.values():
        allowed.update((page, figure) for page, figures in group["pages"].items() for figure in figures)
    found, lines = Counter(), []
    for page in scope():
        name = page.relative_to(ROOT).as_posix().removeprefix("docs/")
        for line, figure, words in typed(page.read_text(encoding="utf-8")):
            if figure not in everywhere:
                found[name, figure] += 1
                lines += [f"{name}:{line}: {figure} | {words[:120]}"] * (found[name, figure] > allowed[name, figure])
    assert not lines, "\n".join(lines)
    assert not allowed - found, "no longer on the page"


def test_blocks_that_are_checked_name_a_test():
    for page in scope():
        for name in CHECKED.findall(page.read_text(encoding="utf-8")):
            assert (ROOT / name.split("::")[0]).is_file(), f"{page.name}: {name}"
