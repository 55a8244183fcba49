"""Hook of the build backend: it compiles the core and names the wheel after the platform."""

import runpy
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

CORE = "src/stickslip/_core"
build = SimpleNamespace(**runpy.run_path(str(Path(__file__).parent / CORE / "build.py")))


class CoreHook(BuildHookInterface):
    """Compile the core before a wheel is filled, for all levels; for an editable one only that of this machine."""

    def dependencies(self) -> list[str]:
        """The package with a compiler, where the machine has none."""
        return [] if build.find_compiler() else [build.ZIGLANG]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build the libraries and add them to the wheel."""
        try:
            self.app.display_info(build.build(levels=() if version == "editable" else build.LEVELS))
        except build.BuildError as error:
            self.app.abort(str(error))
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{build.platform_tag()}"
        names = (build.PROBE, *build.LEVELS)
        build_data["artifacts"] += [f"{CORE}/{build.library_path(name).name}" for name in names]
