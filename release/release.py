"""`make release`: build the wheel and the sdist into dist/, and check them; nothing is uploaded.

The version must be the same in the package, CITATION.cff, .zenodo.json, the conda recipe and the changelog. The wheel
is built from the unpacked sdist by the compiler of the package `ziglang`, so that it runs on old systems as well.
`twine check --strict` checks both, and on Linux `auditwheel` confirms the tag of the wheel. `stickslip doctor` runs in
two new environments without a compiler: with the newest dependencies, and with the oldest that pyproject.toml allows.
`--repository URL` gives the address of the repository, which the sources do not contain. It is written to the metadata,
the README's links and badges, CITATION.cff, .zenodo.json and the conda recipe of the built distributions. The
documentation takes its links to the repository, Binder and Colab from the metadata. A number in the README that is
older than the code on which it depends stops a release.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import tomllib
from pathlib import Path
from urllib.parse import quote

ROOT = Path(__file__).parents[1]
DIST = ROOT / "dist"


def package_version() -> str:
    """Version in the sources of the package."""
    return _find(r'^__version__ = "(.+)"$', ROOT / "src" / "stickslip" / "__init__.py")


def inconsistent_versions() -> list[str]:
    """One sentence for each file whose version is not that of the package."""
    wanted = package_version()
    found = {
        "CITATION.cff": _find(r"^version: (.+)$", ROOT / "CITATION.cff"),
        ".zenodo.json": json.loads((ROOT / ".zenodo.json").read_text(encoding="utf-8"))["version"],
        "release/conda/recipe.yaml": _find(r'^  version: "(.+)"$', ROOT / "release" / "conda" / "recipe.yaml"),
    }
    return [f"{name} has version {one}, the package has {wanted}" for name, one in found.items() if one != wanted]


def unreleased_changes(text: str | None = None) -> str | None:
    """Return a sentence if a changelog lists unreleased changes or has no section for this version, else None."""
    wanted, text = package_version(), text or (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    if re.search(r"^## Unreleased\s+(?!## )\S", text, flags=re.M):
        return f"CHANGELOG.md has changes under '## Unreleased', which are not part of {wanted}: change the version"
    return None if f"\n## {wanted}" in text else f"CHANGELOG.md has no section '## {wanted}': add it"


def stale_numbers() -> list[str]:
    """One sentence for each number in the README that is older than the code on which it depends."""
    sys.path.insert(0, str(ROOT))
    from benchmarks.records import stale_in_readme

    return stale_in_readme()


def _find(pattern: str, path: Path) -> str:
    found = re.search(pattern, path.read_text(encoding="utf-8"), flags=re.M)
    if not found:
        raise SystemExit(f"{path} has no version")
    return found[1]


def run(*words, cwd: Path = ROOT, **variables: str) -> None:
    """Print and run a command with these environment variables; if it fails, raise SystemExit with its exit status."""
    print("$", *words, flush=True)
    if code := subprocess.run([*map(str, words)], cwd=cwd, env=os.environ | variables).returncode:
        raise SystemExit(code)


def environment(place: Path, *packages) -> Path:
    """Create an environment with these packages, and return its folder of programs."""
    run(sys.executable, "-m", "venv", place)
    programs = place / ("Scripts" if os.name == "nt" else "bin")
    run(programs / "python", "-m", "pip", "install", "-q", "--disable-pip-version-check", *packages)
    return programs


def tools(place: Path) -> Path:
    """Create an environment with the pinned tools for a release, including a compiler."""
    locks = (ROOT / f"requirements-{name}.lock" for name in ("release", "compiler"))
    return environment(place, "--require-hashes", *(word for lock in locks for word in ("-r", lock)))


def oldest() -> list[str]:
    """The oldest dependencies that pyproject.toml allows."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return [line.replace(">=", "==") for line in project["dependencies"]]


def urls(address: str) -> dict[str, str]:
    """Addresses that follow from the address of the repository, by their names in `[project.urls]`.

    Binder and Colab open the notebook for a lecture hour; Colab does so only for repositories on GitHub.
    """
    address, version, note = address.rstrip("/"), f"v{package_version()}", "examples/lecture.ipynb"
    found = {
        "Repository": address, "Documentation": f"{address}/blob/{version}/docs/index.md",
        "Issues": f"{address}/issues", "Changelog": f"{address}/blob/{version}/CHANGELOG.md",
        "Binder": f"https://mybinder.org/v2/git/{quote(address, safe='')}/{version}?urlpath=lab/tree/{note}",
    }  # fmt: skip
    if github := re.fullmatch(r"https://github\.com/([^/]+/[^/]+)", address):
        found["Binder"] = f"https://mybinder.org/v2/gh/{github[1]}/{version}?urlpath=lab/tree/{note}"
        found["Colab"] = f"https://colab.research.google.com/github/{github[1]}/blob/{version}/{note}"
    return found


def badges(known: dict[str, str]) -> str:
    """Line of the README with the state of the tests (on GitHub only) and links to the notebook."""
    pictures = {
        "Binder": "https://mybinder.org/badge_logo.svg",
        "Colab": "https://colab.research.google.com/assets/colab-badge.svg",
    }
    tests = f"{known['Repository']}/actions/workflows/test.yml"
    shown = [f"[![tests]({tests}/badge.svg)]({tests})"] if "Colab" in known else []
    return " ".join(shown + [f"[![{name}]({to})]({known[name]})" for name, to in pictures.items() if name in known])


def with_address(source: Path, address: str) -> None:
    """Write the address of the repository into a copy of the sources."""
    known = urls(address)
    address, links = known["Repository"], f"{known['Repository']}/blob/v{package_version()}/"
    table = "\n".join(f'{name} = "{url}"' for name, url in known.items())
    for name, pattern, text in (
        ("pyproject.toml", r"(?m)^\[project\.scripts\]$", f"[project.urls]\n{table}\n\n[project.scripts]"),
        ("README.md", r"(!\[[^]]*\])\((?!\w+:)", rf"\1({links.replace('/blob/', '/raw/')}"),
        ("README.md", r"\]\((?!\w+:)", f"]({links}"),
        ("README.md", "<!-- badges -->", badges(known)),
        ("CITATION.cff", r"(?m)^type: software$", f'type: software\nrepository-code: "{address}"'),
        (
            ".zenodo.json",
            r'(?m)^ "related_identifiers": \[$',
            ' "related_identifiers": [\n  '
            f'{{"identifier": "{address}", "relation": "isSupplementTo", "scheme": "url"}},',
        ),
        ("release/conda/recipe.yaml", r"(?m)^about:$", f"about:\n  homepage: {address}\n  repository: {address}"),
    ):
        path = source / name
        found, count = re.subn(pattern, text, path.read_text(encoding="utf-8"))
        if not count:
            raise SystemExit(f"{name} has no place for the address of the repository")
        path.write_text(found, encoding="utf-8")


def build(python: Path, address: str | None = None) -> list[Path]:
    """Build the sdist, and the wheel from the unpacked sdist alone, with a Python that has the tools of a release."""
    shutil.rmtree(DIST, ignore_errors=True)
    with tempfile.TemporaryDirectory() as folder:
        files = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
        for name in filter(None, files.split("\0")):
            (Path(folder) / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, Path(folder) / name)
        if address:
            with_address(Path(folder), address)
        run(python, "-m", "hatchling", "build", "-t", "sdist", "-d", DIST, cwd=Path(folder))
    (sdist,) = DIST.glob("*.tar.gz")
    with tempfile.TemporaryDirectory() as folder, tarfile.open(sdist) as archive:
        archive.extractall(folder, filter="data")
        (source,) = Path(folder).iterdir()
        run(python, "-m", "hatchling", "build", "-t", "wheel", "-d", DIST, cwd=source, CXX="ziglang")
    (wheel,) = DIST.glob("*.whl")
    return [sdist, wheel]


def check(programs: Path, folder: Path, sdist: Path, wheel: Path) -> None:
    """Check both distributions, and run `stickslip doctor` in two new environments without a compiler."""
    run(programs / "python", "-m", "twine", "check", "--strict", sdist, wheel)
    if sys.platform == "linux":
        run(programs / "auditwheel", "show", wheel)
    for name, packages in (("newest", []), ("oldest", oldest())):
        found = environment(folder / name, wheel, *packages)
        run(found / "stickslip", "doctor", "--quiet", cwd=folder, PATH=str(found), CXX="")


def main() -> None:
    """Build and check a release."""
    words = argparse.ArgumentParser(description="Build and check a release; nothing is uploaded.")
    words.add_argument("--rehearse", action="store_true", help="even if versions do not agree")
    words.add_argument("--repository", metavar="URL", help="address of the repository")
    words.add_argument("--oldest", action="store_true", help="print the oldest dependencies allowed, and nothing else")
    words.add_argument("--address-only", action="store_true", help="only write the address into this checkout")
    given = words.parse_args()
    if given.oldest:
        print(*oldest())
        return
    if given.address_only:
        with_address(ROOT, given.repository or words.error("no address was given: add --repository URL"))
        return
    problems = [*inconsistent_versions(), *filter(None, [unreleased_changes()]), *stale_numbers()]
    if not given.repository:
        problems.append("no address was given: add --repository URL")
    if problems and not given.rehearse:
        raise SystemExit("\n".join(problems))
    for sentence in problems:
        print(f"not ready: {sentence}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        programs = tools(folder / "tools")
        paths = build(programs / "python", given.repository)
        check(programs, folder, *paths)
    print("Checked:", *(f"\n  {path.relative_to(ROOT)}" for path in paths))
    print(f"To publish: git tag v{package_version()}, push the tag, then twine upload dist/*")


if __name__ == "__main__":
    main()
