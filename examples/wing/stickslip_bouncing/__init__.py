"""A wing of stickslip with one experiment: `pip install examples/wing` adds it."""

from stickslip.wing import Wing

WING = Wing(__name__, "a disk that bounces", experiments={"bouncing": "bouncing"})
