"""Contact status, load paths and rigid clusters; public names are in `stickslip.quasirigid`."""
