"""`stickslip cite`: BibTeX that parses, of what a scenario really uses."""

import re
from pathlib import Path

import pytest

import stickslip as ss
from stickslip.experiments.registry import EXPERIMENTS, Experiment
from stickslip.runs import bundled as sources
from tests.conftest import stickslip_here as stickslip

ROOT = Path(__file__).parents[2]
BIB = (ROOT / "src/stickslip/runs/references.bib").read_text(encoding="utf-8")
REQUIRED = {
    "article": {"author", "title", "journal", "year"},
    "phdthesis": {"author", "title", "school", "year"},
    "inproceedings": {"author", "title", "booktitle", "year"},
    "book": {"author", "title", "publisher", "year"},
    "misc": {"author", "title", "year"},
}


def parsed(text):
    """Entries by key, as a parser of BibTeX reads them: kind, and fields whose braces balance."""
    entries, at = {}, 0
    while (at := text.find("@", at)) >= 0:
        head = re.compile(r"@(\w+)\{(\w+),").match(text, at)
        assert head, text[at : at + 40]
        fields, at = {}, head.end()
        while field := re.compile(r"\s*(\w+)\s*=\s*\{").match(text, at):
            depth, end = 1, field.end()
            while depth:
                depth += {"{": 1, "}": -1}.get(text[end], 0)
                end += 1
            assert field[1] not in fields, (head[2], field[1])
            fields[field[1]] = " ".join(text[field.end() : end - 1].split())
            at = end + (text[end] == ",")
        closing = re.compile(r"\s*\}").match(text, at)
        assert closing, text[at : at + 40]
        assert head[2] not in entries
        entries[head[2]], at = (head[1], fields), closing.end()
    return entries


def test_the_parser_refuses_what_is_broken():
    for broken in ("@article{a,\n title = {x},\n", "@article{a b,\n}", "@misc{a, title = {x}, title = {y}}"):
        with pytest.raises((AssertionError, IndexError)):
            parsed(broken)


def test_all_references_have_what_bibtex_needs():
    entries = parsed(BIB)
    assert BIB.isascii()
    for key, (kind, fields) in entries.items():
        assert fields.keys() >= REQUIRED[kind], key
        assert re.fullmatch(r"\d{4}", fields["year"]), key
        assert re.fullmatch(r"10\.\d{4,5}/\S+", fields.get("doi", "10.1000/none")), key
        for name in fields["author"].split(" and "):
            assert name == "others" or re.fullmatch(r"\{.+\}|(\{?[^,{}]+\}?|[^,]+), .+", name), (key, name)
    source = ROOT / "src/stickslip"
    paths = [
        source / "builtin_laws.py",
        source / "runs/bundled.py",
        *(source / "experiments").rglob("*.py"),
        *(source / "wings").rglob("*.py"),
    ]
    used = {word for path in paths for word in re.findall(r'"([A-Za-z0-9]+)"', path.read_text())}
    assert entries.keys() <= used, "a reference that nothing cites"


@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("*.toml")), ids=lambda path: path.stem)
def test_every_example_can_be_cited(path):
    scenarios = sources.read_scenarios(path)
    text = sources.bibtex(*scenarios)
    entries = parsed(text)
    wanted = [key for keys in sources.reference_keys(scenarios[0]).values() for key in keys]
    assert list(entries) == ["stickslip", *wanted]
    assert {"NumPy", "Numba"} <= set(wanted)
    assert all(fields.keys() >= REQUIRED[kind] for kind, fields in entries.values())


def test_every_experiment_knows_its_sources():
    given = Experiment._field_defaults["references"]
    assert all(experiment.references is not given for experiment in EXPERIMENTS.values())


@pytest.mark.parametrize(
    ("tables", "in_it", "not_in_it"),
    [
        ({}, "Charan2020 Mindlin1949", "Silbert2001 LAMMPS Ruina1983"),
        ({"law": {"kind": "linear"}}, "Charan2020 Cundall1979", "Mindlin1949 Hertz1882"),
        ({"experiment": "sphere-shear"}, "Bonfanti2020", "Charan2020"),
        ({"experiment": "quasi-rigid"}, "McNamara2006 Cundall1979", "Mindlin1949"),
        ({"experiment": "gouge"}, "Ferdowsi2021 Silbert2001 Ruina1983", "LAMMPS"),
        ({"experiment": "gouge", "engine": "lammps"}, "LAMMPS", "Charan2020"),
        ({"experiment": "catalogue", "shear": {"drag": 0.1}}, "Ishima2022 Hanley1982 Mindlin1949", "Bonfanti2020"),
        ({"experiment": "rate-state"}, "Ruina1983", "Dieterich1979 Linker1992 Cundall1979"),
        ({"experiment": "fault"}, "Erickson2020 Rice1993 Rubin2005 Dieterich1979", "LAMMPS"),
        (
            {"experiment": "rate-state", "surface": {"law": "aging", "alpha": 0.1}},
            "Dieterich1979 Ruina1983 Linker1992",
            "LAMMPS",
        ),
    ],
)
def test_what_is_cited_follows_the_scenario(tables, in_it, not_in_it):
    if tables.get("experiment") == "gouge":
        tables = tables | {"law": {"damping_n": 1e4}, "protocol": [{"kind": "slide", "velocity": 0.3, "slip": 1.0}]}
    keys = {key for keys in sources.reference_keys(ss.scenario(**tables)).values() for key in keys}
    assert keys >= set(in_it.split())
    assert not keys & set(not_in_it.split())


def test_a_sweep_rests_on_what_any_of_its_members_does(tmp_path):
    (tmp_path / "sweep.json").write_text('{"sweep": {"law.kind": ["linear", "hertz_mindlin"]}}')
    keys = list(parsed(sources.bibtex(*sources.read_scenarios(tmp_path))))
    assert {"Charan2020", "Cundall1979", "Mindlin1949"} <= set(keys)
    assert keys[-len(sources.LIBRARIES) :] == list(sources.LIBRARIES)


def test_the_package_is_cited_as_its_citation_file_says():
    kind, fields = parsed(sources.package_entry())["stickslip"]
    said = (ROOT / "CITATION.cff").read_text()
    assert kind == "misc"
    assert f"\nversion: {ss.__version__}\n" in said
    assert fields["note"].startswith(f"Version {ss.__version__}")
    assert fields["title"].strip("{}") in said
    for doi in re.findall(r"^ +doi: (\S+)$", said, flags=re.M):
        assert f"doi = {{{doi}}}" in BIB


def test_people_in_the_citation_file_are_read(monkeypatch, tmp_path):
    (tmp_path / "CITATION.cff").write_text(
        'title: "T"\nauthors:\n  - family-names: Doe\n    given-names: "Jane A."\n    orcid: https://x.org/1\n'
        '  - name: "The others"\nversion: 2.0\ndate-released: 2026-11-21\nlicense: MIT\ndoi: 10.1000/1\n\nreferences:\n'
        "  - type: article\n    title: no\n"
    )
    monkeypatch.setattr(sources, "HERE", tmp_path)
    _, fields = parsed(sources.package_entry())["stickslip"]
    assert fields["author"] == "Doe, Jane A. and {The others}"
    assert fields["doi"] == "10.1000/1"


def test_the_command_takes_a_scenario_or_a_folder_of_results(tmp_path):
    run = stickslip("cite", ROOT / "examples/disk_array.toml")
    assert run.returncode == 0, run.stderr
    assert "Charan2020" in parsed(run.stdout)
    (tmp_path / "scenario.json").write_text(ss.scenario(experiment="rate-state").text)
    run = stickslip("cite", tmp_path)
    assert {"stickslip", "Ruina1983"} <= parsed(run.stdout).keys()
    for wrong in (tmp_path / "absent.toml", ROOT / "docs"):
        run = stickslip("cite", wrong)
        assert (run.returncode, run.stdout, run.stderr.count("\n")) == (2, "", 1)
        assert "cannot be read" in run.stderr
