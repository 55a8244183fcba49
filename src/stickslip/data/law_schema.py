"""Tables of a scenario that select a contact law, and construction of the law."""

from typing import Literal

from pydantic import Field

from ..core.laws.builtin import Law, for_pair, hertz_mindlin, linear
from .law_file import LawFile, load_law
from .schema import NotNegative, Positive, ScenarioTable


class Parameters(ScenarioTable):
    """Parameters of disk–wall contacts, if different from those between disks."""

    kn: Positive | None = Field(None, description="as `law.kn`")
    kt: NotNegative | None = Field(None, description="as `law.kt`")
    mu: NotNegative | None = Field(None, description="as `law.mu`")
    damping_n: NotNegative | None = Field(None, description="as `law.damping_n` [force time/length]")
    damping_t: NotNegative | None = Field(None, description="as `law.damping_t` [force time/length]")


class LawChoice(LawFile):
    """Contact law and its parameters."""

    kind: Literal["hertz_mindlin", "linear"] = Field("hertz_mindlin", description="F_n = k_n δ^(3/2), or k_n δ")
    coulomb: Literal["smooth", "sharp"] = Field("smooth", description="approach of F_t to the Coulomb limit μ F_n")
    kn: Positive = Field(1.0, description="k_n; in force/length for a linear law [force/length^(3/2)]")
    kt: NotNegative = Field(2 / 7, description="k_t, as `kn` [force/length^(3/2)]")
    mu: NotNegative = Field(10.0, description="friction between grains")
    damping_n: NotNegative = Field(0.0, description="of the normal dashpot [force time/length]")
    damping_t: NotNegative = Field(0.0, description="of the tangential dashpot [force time/length]")
    wall: Parameters = Parameters()


def make_law(choice: LawChoice) -> Law:
    """Contact law selected by a scenario, with separate disk–wall parameters if these differ."""
    if choice.file is not None:
        law = load_law(choice)
    else:
        law = {"hertz_mindlin": hertz_mindlin, "linear": linear}[choice.kind](
            choice.kn, choice.kt, choice.mu, coulomb=choice.coulomb, damping_n=choice.damping_n,
            damping_t=choice.damping_t,
        )  # fmt: skip
    return for_pair(law, 0, SUBSTRATE, **{k: v for k, v in choice.wall.model_dump().items() if v is not None})


SUBSTRATE = 1  # material of the wall; disks are material 0
