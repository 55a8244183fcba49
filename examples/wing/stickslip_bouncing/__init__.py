"""A wing of stickslip with one experiment and a page about it: `pip install examples/wing` adds them."""

from stickslip.wing import Wing

WING = Wing(__name__, "a disk that bounces", experiments={"bouncing": "bouncing"}, pages=("bouncing",))
