"""Laws in files: from scenarios and the command line only, never from results; what is on disk knows them again."""

import json
import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.laws import kinds
from stickslip.core.laws.builtin import parameter_names
from stickslip.data import archive, law_schema
from stickslip.data.sample import PackingError
from stickslip.experiments.registry import read_tables, scenario
from stickslip.runs.sweep.definition import members as sweep_members
from tests.conftest import make_packing, stickslip_here, stirred

EXAMPLES = Path(__file__).parents[2] / "examples"
FLOW = """
experiment = "flow"
samples = 20
gravity = [0.0, -1.0]
[grains]
number = 12
dim = 2
density = 1.0
low = [0.0, 0.0]
high = [4.0, 10.0]
[law]
file = "mine.py"
parameters = { kn = 2e4, damping_n = 20.0 }
[[walls]]
name = "floor"
point = [0.0, 0.0]
normal = [0.0, 1.0]
mu = 0.1
[[walls]]
name = "left"
point = [0.0, 0.0]
normal = [1.0, 0.0]
[[walls]]
name = "right"
point = [4.0, 0.0]
normal = [-1.0, 0.0]
[[stages]]
name = "pour"
duration = 0.02
"""


@pytest.fixture
def folder(tmp_path):
    """A scenario and its law side by side."""
    shutil.copy(EXAMPLES / "rolling_law.py", tmp_path / "mine.py")
    (tmp_path / "flow.toml").write_text(FLOW)
    return tmp_path


def forget(law, monkeypatch):
    """As in another process: the law is not known."""
    monkeypatch.delitem(kinds.USER_LAWS, law.kind)


def test_a_scenario_names_a_file_beside_it_and_knows_its_text(folder):
    chosen = scenario(trust=True, **read_tables(folder / "flow.toml"))
    assert Path(chosen.law.file) == folder / "mine.py" and len(chosen.law.checksum) == 16
    again = scenario(**json.loads(chosen.text))
    assert again == chosen and again.digest == chosen.digest
    law = ss.packings.poured(chosen).law
    assert law.table[0, 0, 0] == 2e4 and law.table[0, 1, 2] == 0.1 and law.table[0, 0, 5] == 0.1
    (folder / "mine.py").write_text((folder / "mine.py").read_text() + "\n# changed\n")
    assert scenario(**json.loads(chosen.text)) == chosen  # reading what was written runs nothing …
    with pytest.raises(ss.experiments.ScenarioError, match=r"mine\.py has changed since the run began"):
        ss.packings.poured(chosen)  # … and nothing else than what was named is run
    (folder / "mine.py").unlink()
    with pytest.raises(ss.experiments.ScenarioError, match="no longer exists"):
        ss.packings.poured(chosen)


def test_scenarios_without_a_file_are_what_they_were():
    assert not {"file", "parameters", "checksum"} & set(json.loads(scenario().text)["law"])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('file = "mine.py"', 'file = "mine.py"\nkn = 1.0', "law.kn does not apply with law.file"),
        ('file = "mine.py"', "kn = 1.0", "law.parameters requires law.file"),
        ('file = "mine.py"', 'file = "other.py"', "other.py is not a file"),
        ("kn = 2e4", "kn = -1.0", "kn must be finite and positive, got -1.0"),
        ("kn = 2e4", "stiff = 1.0", "no parameter 'stiff': it has kn, kt, mu, mu_r"),
    ],
)
def test_a_wrong_table_ends_with_a_sentence_before_anything_starts(old, new, message, folder):
    (folder / "flow.toml").write_text(FLOW.replace(old, new))
    said = stickslip_here("run", folder / "flow.toml", "--out", folder / "out", "--trust")
    assert said.returncode == 2 and message in said.stderr and not (folder / "out").exists()


def test_a_law_that_does_not_compile_ends_with_its_line(folder):
    (folder / "mine.py").write_text("def normal_force(overlap:\n    return overlap\n")
    said = stickslip_here("run", folder / "flow.toml", "--out", folder / "out", "--trust")
    assert said.returncode == 2 and "mine.py does not compile, line 1: 'def normal_force(overlap:'" in said.stderr
    np.savez(folder / "pair.npz", position=[[0, 0], [0.99, 0]], radius=[0.5, 0.5], dim=2)
    said = stickslip_here("stability", folder / "pair.npz", "--law", folder / "mine.py")
    assert said.returncode == 2 and "line 1" in said.stderr and "Traceback" not in said.stderr


def test_results_never_run_code(tmp_path, monkeypatch):
    trap = tmp_path / "trap.py"
    trap.write_text(f"open({str(tmp_path / 'sprung')!r}, 'w')\n")
    np.savez(tmp_path / "pair.npz", position=[[0, 0, 0], [0.99, 0, 0]], radius=[0.5, 0.5], law=str(trap))
    with pytest.raises(PackingError, match="law must be hertz_mindlin"):
        ss.io.read_packing(tmp_path / "pair.npz")
    law = ss.laws.from_file(EXAMPLES / "rolling_law.py")
    archive.write(tmp_path / "state.h5", {"state": make_packing(3), "law": law})
    assert archive.read(tmp_path / "state.h5")["law"].kind == law.kind
    forget(law, monkeypatch)
    with pytest.raises(
        archive.ArchiveError, match=r"'rolling_law', a user-defined contact law .* first create that law"
    ):
        archive.read(tmp_path / "state.h5")
    ss.laws.from_file(EXAMPLES / "rolling_law.py")
    assert archive.read(tmp_path / "state.h5")["law"].kind == law.kind
    assert not (tmp_path / "sprung").exists()


@pytest.mark.parametrize("ending", [".h5", ".gsd"])
def test_files_keep_the_memory_of_rolling_and_know_the_law_again(ending, tmp_path):
    if ending == ".gsd":
        pytest.importorskip("gsd")
    law = ss.laws.from_file(EXAMPLES / "rolling_law.py", mu_r=1.5)
    law = ss.laws.for_pair(law, 0, 1, mu_r=1.0)
    state = stirred(make_packing(3, wall=False), law, np.random.default_rng(0), size=0.05)
    assert state.contacts.rolling[:, 6].any()
    ss.io.write_packing(tmp_path / f"state{ending}", state, law)
    back, its_law, _ = ss.io.read_packing(tmp_path / f"state{ending}")
    count = int(state.contacts.count[0])
    np.testing.assert_array_equal(back.contacts.rolling[:count], state.contacts.rolling[:count])
    assert its_law.kind == law.kind and isinstance(its_law.kind, kinds.Kind)
    np.testing.assert_array_equal(its_law.table, law.table)
    assert "the memory of rolling" in ss.io.write_packing(tmp_path / "state.npz", state, law)[-1]


def test_archives_without_rolling_memory_still_read(tmp_path):
    state = make_packing(2)
    archive.write(tmp_path / "new.h5", {"state": state})
    import h5py

    with h5py.File(tmp_path / "new.h5", "r") as file:
        fields = {name: item[()] for name, item in file["state/contacts"].items() if name != "rolling"}
    assert ss.Contacts(**fields).rolling is None


@pytest.mark.slow
def test_the_command_line_analyses_a_packing_under_a_user_defined_law(tmp_path):
    dry = ss.laws.hertz_mindlin(coulomb="sharp")
    state, _ = ss.equilibrate(ss.packings.jammed(12, packing_fraction=0.9, dim=2, seed=1)[0], dry, tolerance=1e-12)
    ss.io.write_packing(tmp_path / "packing.npz", state, dry)
    law = EXAMPLES / "cohesive_law.py"
    said = stickslip_here("stability", "packing.npz", "--law", law, "--mu", "0.3", cwd=tmp_path)
    assert said.returncode == 3, said.stderr
    text = " ".join(said.stdout.split())
    assert "law: cohesive_law, sharp Coulomb, kn = 1, kt = 0.2857, mu = 0.3, tension = 0.0001" in text
    assert "not in equilibrium" in text  # which the bridges have disturbed
    ours = stickslip_here("stability", "packing.npz", "--json", "--law", law, cwd=tmp_path)
    theirs = stickslip_here("stability", "packing.npz", "--json", cwd=tmp_path)
    pairs = [json.loads(run.stdout) for run in (ours, theirs)]
    assert pairs[0]["contacts"] >= pairs[1]["contacts"] and pairs[1]["stable"]
    assert pairs[0]["residual"] > 1e-4 > 1e-9 > pairs[1]["residual"]


@pytest.mark.slow
def test_the_command_line_lets_a_packing_settle_under_another_law():
    law = ("--law", EXAMPLES / "cohesive_law.py")
    said = stickslip_here("stability", EXAMPLES / "sheared_spheres.npz", *law, "--settle", "--json")
    answer = json.loads(said.stdout)
    assert answer["residual"] < 1e-9
    assert any(note.startswith("settled: ") for note in answer["notes"])


def test_a_law_from_a_file_travels_to_other_processes(tmp_path):
    law = ss.laws.from_file(EXAMPLES / "cohesive_law.py", tension=2e-4)
    (tmp_path / "law").write_bytes(pickle.dumps(law))
    asked = "law = pickle.load(open('law', 'rb')); print(law.kind, parameter_names(law), law.table[0, 0, -3])"
    text = f"import pickle; from stickslip.core.laws.builtin import parameter_names; {asked}"
    said = subprocess.run([sys.executable, "-c", text], cwd=tmp_path, capture_output=True, text=True)
    assert said.stdout.strip() == f"{law.kind} {parameter_names(law)} 0.0002", said.stderr


@pytest.mark.slow
def test_a_flow_runs_with_a_user_defined_law(folder):
    said = stickslip_here("run", folder / "flow.toml", "--out", folder / "out", "--trust")
    assert said.returncode == 0, said.stderr
    assert (folder / "out" / "results.h5").exists()
    cited = stickslip_here("cite", folder / "out")
    assert cited.returncode == 0 and "stickslip" in cited.stdout


def test_report_and_export_execute_a_law_only_where_they_must_and_may(folder, monkeypatch):
    monkeypatch.setattr(law_schema, "TRUSTED", folder / "trusted.txt")  # nobody has allowed this text yet
    mine, toml = folder / "mine.py", folder / "flow.toml"
    said = stickslip_here("run", toml, "--export", folder / "job", "--engine", "lammps")
    assert said.returncode == 2 and "LAMMPS has only built-in laws" in said.stderr
    assert stickslip_here("run", toml, "--out", folder / "out", "--trust", "-q").returncode == 0
    mine.write_text(mine.read_text() + "# changed\n")
    said = stickslip_here("report", folder / "out")
    assert said.returncode == 2 and "mine.py has changed since the run began" in said.stderr
    mine.write_text(mine.read_text().removesuffix("# changed\n"))
    assert stickslip_here("report", folder / "out", "-q").returncode == 0


def test_parameters_of_a_file_are_swept_by_name(folder):
    toml = folder / "flow.toml"
    toml.write_text(FLOW + '[sweep]\n"law.parameters.mu_r" = [0.0, 0.3]\n')
    assert stickslip_here("run", toml, "--out", folder / "out", "--trust", "--workers", "1", "-q").returncode == 0
    data = ss.io.open_dataset(folder / "out")
    assert data["law.parameters.mu_r"].values.tolist() == [0.0, 0.3] and data["finished"].values.all()
    toml.write_text(FLOW + '[sweep]\nmode = "sample"\nnumber = 3\n"law.parameters.mu_r" = {uniform = [0.0, 0.3]}\n')
    values = [member.scenario.law.parameters["mu_r"] for member in sweep_members(ss.io.read_sweep(toml))]
    assert len(set(values)) == 3 and all(0 < value < 0.3 for value in values)
    toml.write_text(FLOW + '[sweep]\n"law.parameters.stiff" = [0.0, 0.3]\n')
    said = stickslip_here("run", toml, "--out", folder / "other", "--trust")
    assert said.returncode == 2 and "no parameter 'stiff': it has kn, kt, mu, mu_r" in said.stderr
    assert not (folder / "other").exists()
    with pytest.raises(ss.experiments.ScenarioError, match=r"as in law\.parameters\.NAME"):
        ss.sweep(**read_tables(folder / "flow.toml") | {"sweep": {"law.parameters": [1.0]}})


def test_a_law_prints_its_name_and_all_parameters():
    law = ss.laws.from_file(EXAMPLES / "rolling_law.py", mu_r=0.2)
    assert repr(law) == "Law: rolling_law, sharp Coulomb, kn = 1, kt = 0.8, mu = 0.5, mu_r = 0.2"
    pair = ss.laws.for_pair(ss.laws.linear(1.0, 0.5, 0.1, damping_n=0.2), 0, 1, mu=0.4)
    assert repr(pair) == "Law: linear, sharp Coulomb, 2 materials, kn = 1, kt = 0.5, mu = 0.1 to 0.4, damping_n = 0.2"
