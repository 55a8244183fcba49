"""What README and docs show must run."""

import re
from operator import attrgetter
from pathlib import Path
from types import ModuleType

import pytest

import stickslip
from stickslip.cli.app import commands, commands_like
from stickslip.words import meant, suggestions

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("page", "number", "message"),
    [
        ("README.md", 0, ("oscillatory instability: 1 complex pair",)),
        ("docs/index.md", 0, ("3 complex pairs", "limit")),
        ("docs/index.md", 1, ("oscillatory instability: 1 complex pair",)),
        ("docs/index.md", 2, ("the lid carries ", " events; ")),
        ("docs/quasi_rigid.md", 0, (" events,", " alternatives")),
        ("docs/quasi_rigid.md", 1, ("MECHANISM 0.8",)),
        ("docs/quasi_rigid.md", 2, ("[106  41  17] 37 [109  42  17] 33",)),
        pytest.param(
            "docs/quasi_rigid.md",
            4,
            ("the force grows: the full load was reached", "the lid is moved: "),
            marks=pytest.mark.slow,
        ),
        ("docs/quasi_rigid.md", 4, ("'UNIQUE': ", "'MECHANISM': ")),
        ("docs/faults.md", 3, ("M_w [4.", "[ True False]")),
        ("docs/look.md", 0, ("2 axes",)),
        ("docs/many_runs.md", 0, ("'spring.stiffness': 4, 'seed': 2", "1/m")),
        (
            "docs/rate_and_state.md",
            0,
            ("reached its end", "these data determine all parameters", "prefer the slip law"),
        ),
    ],
)
def test_the_examples_run_and_are_short(page, number, message, tmp_path, monkeypatch, capsys):
    code = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), flags=re.S)[number]
    assert len(code.strip().splitlines()) <= 15
    monkeypatch.chdir(tmp_path)
    exec(compile(code, page, "exec"), {"__name__": "__main__"})
    printed = capsys.readouterr().out
    assert all(words in printed for words in message), printed


def test_links_and_commands_exist():
    for target in re.findall(r"\]\((?!http)([^)#\s]+)", README):
        assert (ROOT / target).exists(), target
    makefile = (ROOT / "Makefile").read_text()
    for word in re.findall(r"make (\w+)", README):
        assert re.search(rf"^{word}:", makefile, flags=re.M) or word == "demo", word


TOP = [getattr(stickslip, name) for name in stickslip.__all__]
NAMESPACES = [thing for thing in TOP if isinstance(thing, ModuleType)]
EXPERIMENTS = [getattr(stickslip.experiments, name) for name in stickslip.experiments.__all__ if name.islower()]


@pytest.mark.parametrize("space", [stickslip, *NAMESPACES, *EXPERIMENTS], ids=lambda space: space.__name__)
def test_every_public_name_loads_and_is_documented(space):
    assert space.__doc__
    assert set(dir(space)) >= set(space.__all__)
    for name in space.__all__:
        thing = getattr(space, name)
        assert name == "__version__" or name.isupper() or thing.__doc__, name


@pytest.mark.parametrize("space", [stickslip, *NAMESPACES], ids=lambda space: space.__name__)
def test_help_is_a_table_of_contents(space):
    """`help` of a namespace has a line for each of its names, except for the modules that heads of wings name."""
    found = {} if space is stickslip else {n for n in space.__all__ if isinstance(getattr(space, n), ModuleType)}
    names = [n for n in space.__all__ if not n.startswith("_") and n not in found]
    missing = [n for n in names if not re.search(rf"\b{n}\b", space.__doc__)]
    assert not missing


def test_the_top_level_is_small_and_names_differ_by_more_than_case():
    assert len(stickslip.__all__) <= 52
    for space in (stickslip, *NAMESPACES, *EXPERIMENTS):
        low = [name.lower() for name in space.__all__ if not isinstance(getattr(space, name), ModuleType)]
        assert len(set(low)) == len(low), space.__name__


def test_every_function_has_one_path():
    """No function is public in two namespaces."""
    seen = {}
    for space in (stickslip, *NAMESPACES, *EXPERIMENTS):
        for name in space.__all__:
            thing = getattr(space, name)
            if callable(thing):
                assert seen.setdefault(thing, space) is space, f"{name} is in {seen[thing].__name__}, {space.__name__}"


@pytest.mark.parametrize(
    ("space", "wrong", "near"),
    [
        (stickslip, "spectrun", "spectrum"),
        (stickslip, "jammed", "packings.jammed"),
        (stickslip.friction, "healings", "healing"),
        (stickslip.figures, "muvie", "movie"),
        (stickslip.packings, "jamed", "jammed"),
        (stickslip.modes, "sensitivity", "contact_sensitivity"),
        (stickslip.ensemble, "run_member", "run_members"),
        (stickslip.results, "Spectrun", "Spectrum"),
    ],
)
def test_an_attribute_that_does_not_exist_names_the_nearest_one(space, wrong, near):
    with pytest.raises(AttributeError, match=rf"did you mean {space.__name__}\.{near}\?"):
        getattr(space, wrong)


def test_a_name_in_two_namespaces_names_both():
    text = r"did you mean stickslip\.modes\.complex_pairs or stickslip\.figures\.disk_array\.complex_pairs\?"
    with pytest.raises(AttributeError, match=text):
        stickslip.complex_pairs  # noqa: B018


def test_names_of_other_programs_lead_to_names_that_exist():
    with pytest.raises(AttributeError, match=r"did you mean stickslip\.packings\.jammed\?"):
        stickslip.packings.random  # noqa: B018
    with pytest.raises(AttributeError, match=r"did you mean stickslip\.io\.read_packing or `stickslip convert`\?"):
        stickslip.read  # noqa: B018
    with pytest.raises(AttributeError, match=r"did you mean `stickslip report`\?"):
        stickslip.report  # noqa: B018
    for path in meant():
        if not path.startswith("`"):
            assert attrgetter(path)(stickslip), path
        elif path.startswith("`stickslip ") and "--" not in path:
            assert path.strip("`").split()[1] in [*commands()]


NAMES = """
    read_lammps_dump load_dump Packing coordination_number contact_network force_chains pair_correlation HertzMindlin
    aging_law steady_state_friction velocity_step stress_drop b_value FaultGouge direct_shear oedometer void_ratio
    dilatancy_angle undrained_shear angle_of_repose flow_function particle_size_distribution jam hessian d2min
    nonaffine_displacement AQS Disk block_on_spring stability_matrix lcp solve integrate save element_tests mass_matrix
    contact_force eigenvectors critical_state silo set_threads cuda lees_edwards pebble_game video dataframe forecast
    unloading penetration granular_temperature soft_spots bonds cement belt vibration hysteresis afterslip dc creep
    tremor color progress cite shear_strength peak_friction stress_strain_curve Scene O ball eigvals eigvalsh gr triax
    plotting viz linalg analysis potential engines hcp fcc cloud units wall biax stats
"""
COMMANDS = (
    "list new sweep triaxial fault help export import init info plot pack status submit restart ratestate test ls "
    "log compare merge monitor fail predict film figure upgrade completion schema gui why cancel"
)


def test_names_that_people_guess_lead_somewhere():
    """Written down before they were tried, by people of eight professions."""
    assert [name for name in NAMES.split() if not suggestions(name)] == []
    known = [*commands()]
    assert [word for word in COMMANDS.split() if not commands_like(word, known)] == []
    assert commands_like("undrained", known) == ['`stickslip run SCENARIO` with experiment = "element-test"']
    assert commands_like("restart", known) == ["`stickslip resume`"] and "convert" in commands_like("export", known)[0]


@pytest.mark.parametrize(
    ("word", "near"),
    [
        ("particles", "Grains"), ("mass", "Grains"), ("radii", "Grains"), ("openmp", "`stickslip doctor`"),
        ("skempton", "experiments.element_test"), ("compression_index", "experiments.element_test"),
        ("fit_envelope", "experiments.element_test"), ("histogram", None), ("train", None),
        ("sparse", "io.write_matrices"), ("cement", "packings.bonded"), ("triax", "experiments.element_test"),
    ],
)  # fmt: skip
def test_a_word_leads_to_its_own_subject_or_nowhere(word, near):
    assert suggestions(word)[:1] == ([near] if near else [])


def test_a_subject_that_examples_mention_is_not_one_of_them():
    known = [*commands()]
    assert not any("injection" in line for line in commands_like("friction", known))


@pytest.mark.parametrize("word", ["clump", "crushing", "temperature", "lubrication", "stl"])
def test_subjects_of_other_codes_are_said_to_be_absent(word):
    with pytest.raises(AttributeError, match=r"has no attribute '\w+': .* lists codes that have more"):
        getattr(stickslip, word)


@pytest.mark.parametrize("word", ["qwertz", "about", "size"])
def test_no_name_is_better_than_a_misleading_one(word):
    with pytest.raises(AttributeError, match=r"has no attribute '\w+': see help\(stickslip\)"):
        getattr(stickslip, word)
